"""Use cases: what the service does, free of HTTP and SQL.

Services receive their collaborators through the ports of :mod:`app.services.ports`, take and return the
frozen records of :mod:`app.services.records`, raise the errors of :mod:`app.services.errors`, and are
synchronous and safe to call from several threads: one call, one transaction.
"""
