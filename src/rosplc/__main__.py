"""``python -m rosplc`` is the ``rosplc`` command."""

from rosplc.cli import main

main()
