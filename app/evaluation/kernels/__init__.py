"""Kernels beside what others offer for the same work, timed in turn in one process."""

from app.evaluation.kernels.runner import Comparison, Row, Units, compare
from app.evaluation.kernels.tasks import TASKS, run_kernels

__all__ = ["TASKS", "Comparison", "Row", "Units", "compare", "run_kernels"]
