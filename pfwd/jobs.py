"""Calls in worker processes, for the screen and the commands; see :mod:`pfwd_device.jobs`."""

from pfwd_device.jobs import Jobs, Task, TaskProgress, WorkerDied, report

__all__ = ["Jobs", "Task", "TaskProgress", "WorkerDied", "report"]
