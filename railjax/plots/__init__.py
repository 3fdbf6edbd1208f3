"""Figures of more than one kind of result, the running vehicle from above, films; a result's own figure is its method `plot`.

Imports everything from base to sweeps. What users call stands here.
"""

from ..base.style import figure
from .charts import histories

__all__ = ["figure", "histories"]
