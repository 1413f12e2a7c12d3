"""The contenders in Python: ``python -m rosplc_bench.peers NAME SIDE ARGUMENTS`` runs side A or B."""
