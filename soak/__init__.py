"""The fault campaign: rosplc under load, while its parts are killed, stopped, starved and reloaded.

``make soak`` runs it; docs/explanation/fault-campaign.md says what it claims and what it found.

========== =======================================================================================
cell       the system under test: bridge, PLC, ROS publisher, ROS subscriber, router or master
plc, peers the processes beside the bridge; every message is filled with a pattern
ledger     shared counters, which survive the death of whoever writes them
faults     what is done to the cell, one class each
checks     what must hold after each round
campaign   rounds in random order, from a seed
report     the summary for people, JSON for everything else
========== =======================================================================================
"""
