"""Evaluation: public data sets, metrics and reports.

Drives the engine directly, or a running service through a :class:`app.evaluation.drivers.Transport` that the
caller supplies; it knows neither HTTP nor a database.
"""
