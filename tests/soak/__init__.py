"""The fault campaign: rosplc under load, while its parts are killed, stopped, starved and reloaded.

``make soak`` runs it; docs/explanation/fault-campaign.md explains what it claims and what it found.

=========== ======================================================================================
cell        the system under test: bridge, PLC, ROS publisher, ROS subscriber, router or master
plc, st     the PLC's process: a program for the virtual PLC, or generated Structured Text, executed
peers       the ROS nodes; every message is filled with a pattern
messages    the patterns, and shared counters that survive the death of their writer
processes   the processes of a cell, and the server that forks Python processes quickly
faults      what is done to the cell, one class each
checks      what must hold after each round
campaign    rounds in random order, from a seed, and what is kept of a round that failed
mix         several cells at once
results     tables over many rounds, and the trends in them; draw: figures
report      the summary for people, JSON for programs
=========== ======================================================================================
"""
