"""What is wrong with something a phone sent.

::

    InputError
    └── FormatError           not what the phone's application writes (names the field and the remedy)
"""

from __future__ import annotations

from app.engine.errors import InputError


class FormatError(InputError):
    """A message or file that is not in the format it should be in."""
