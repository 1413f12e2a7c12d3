"""Fuzzers of everything that rosplc reads from others.

``python -m tests.fuzz`` runs them (``make fuzz``); docs/explanation/hostile-input.md says what they found.

=========== ====================================================================================
targets     what is fuzzed in Python: one module each, a function that takes bytes
native      what is fuzzed in C, under sanitizers: the codec's plans, and channels
choices     bytes as decisions, for inputs with more than one part
oracle      what may come out of a Python entry point: an error of rosplc's, and nothing else
counts      executions and bytes, in memory that a dead fuzzer leaves behind
worker      one fuzzer in a process of its own (atheris)
replay      the corpus, without a fuzzing library
build       the C targets, for libFuzzer and for the replay
campaign    all of them, with progress
corpus      inputs worth keeping, and how they are kept small
report      what a campaign did: JSON, a table for people, the table in the documentation
=========== ====================================================================================

``corpus`` holds a small part of each target's inputs, ``regressions`` each input that once
found a defect. Both are replayed by ``make test``.
"""
