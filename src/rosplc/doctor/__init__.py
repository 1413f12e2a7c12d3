"""``rosplc doctor``: examines the machine, a configuration and what runs, and suggests what to do.

It only looks: nothing is claimed, locked, published or written. Each examination is a function of what it is
given (a folder in place of ``/proc``, a mapping in place of the environment);
:mod:`rosplc.doctor.examination` gives them the real ones.
"""

from rosplc.doctor.examination import Question, examine
from rosplc.doctor.finding import SCHEMA, Area, Finding, Kind, Level, Report
from rosplc.doctor.kinds import KINDS

__all__ = ["KINDS", "SCHEMA", "Area", "Finding", "Kind", "Level", "Question", "Report", "examine"]
