"""``rosplc doctor``: examines the machine, a configuration and running bridges, and suggests fixes.

It only reads: nothing is claimed, locked, published or written. Each examination is a function of its
arguments (a folder instead of ``/proc``, a mapping instead of the environment);
:mod:`rosplc.doctor.examination` passes the real ones.
"""

from rosplc.doctor.examination import Question, examine
from rosplc.doctor.finding import SCHEMA, Area, Finding, Kind, Level, Report
from rosplc.doctor.kinds import KINDS

__all__ = ["KINDS", "SCHEMA", "Area", "Finding", "Kind", "Level", "Question", "Report", "examine"]
