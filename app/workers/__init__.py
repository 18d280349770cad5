"""Adapters of the executor port, the tasks they run, and the runner that feeds them from the durable queue."""
