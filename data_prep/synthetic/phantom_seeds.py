"""Which phantom cohorts choose settings, and which are reported: never the same.

A number, a default or a choice between methods that was made by looking at phantoms was made on the
development seeds. Figures that are published come from the reported ones, on which nothing was
chosen; a test refuses settings files that name them.
"""

from __future__ import annotations

DEVELOPMENT = (0, 1, 2)
REPORTED = (9001, 9002, 9003)
