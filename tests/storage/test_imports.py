"""What a worker imports when it opens its first map."""

from __future__ import annotations

import subprocess
import sys


def test_the_map_cache_comes_without_sql() -> None:
    code = "import sys; from app.storage.map_cache import open_map; print('sqlalchemy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
