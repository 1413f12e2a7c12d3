"""``python -m rosplc_bench`` is ``rosplc-bench``."""

from rosplc_bench.cli import main

raise SystemExit(main())
