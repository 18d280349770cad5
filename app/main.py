"""Composition root of the service: builds every part, starts and stops them in order, and serves HTTP."""

from __future__ import annotations

# The HTTP layer is called like this; ``metrics`` counts requests and renders ``/metrics``, ``ready`` says per part
# whether it works, ``lifespan`` starts and stops everything that has threads or processes:
#
#     create_api(
#         *, services: Services, broker: JobBroker, settings: Settings, metrics: Metrics,
#         ready: Callable[[], Mapping[str, bool]], lifespan: Lifespan[FastAPI],
#     ) -> FastAPI
