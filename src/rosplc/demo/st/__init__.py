"""The demonstration's PLC program in Structured Text, translated to C and run.

Only in a checkout of the sources: the translator is in ``tests/st/rosplc_st`` and needs
blark, whose licence (GPL) keeps it out of what rosplc depends on.
"""

__all__: list[str] = []
