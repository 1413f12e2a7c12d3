"""The fault campaign: rosplc under load, while its parts are killed, stopped, starved and reloaded.

``make soak`` runs it; docs/explanation/fault-campaign.md says what it claims and what it found.

=========== ======================================================================================
cell        the system under test: bridge, PLC, ROS publisher, ROS subscriber, router or master
plc, st     the PLC's process: a program for the virtual PLC, or generated Structured Text, executed
peers       the ROS nodes; every message is filled with a pattern
ledger      shared counters, which survive the death of whoever writes them
faults      what is done to the cell, one class each; plc_faults: what only Structured Text can have
checks      what must hold after each round; trend: what must hold over many
campaign    rounds in random order, from a seed; bundle: what is kept of a round that failed
mix         several cells at once
report      the summary for people, JSON for everything else; results and draw: tables and figures
=========== ======================================================================================
"""
