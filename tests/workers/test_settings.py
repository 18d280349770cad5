import re
from pathlib import Path

import pytest
from pydantic import ValidationError

from app.settings import LogLevel, PoolKind, Settings

DOCS = Path(__file__).resolve().parents[2] / "docs" / "settings.md"


@pytest.fixture(autouse=True)
def _nowhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def documented() -> dict[str, str]:
    """Default as written, by variable."""
    return dict(re.findall(r"^\| `(ISODYN_\w+)` \| (.+?) \|", DOCS.read_text(), flags=re.MULTILINE))


def test_every_setting_is_documented_and_nothing_else() -> None:
    assert set(documented()) == {f"ISODYN_{name.upper()}" for name in Settings.model_fields}


@pytest.mark.parametrize("name", sorted(set(Settings.model_fields) - {"workers"}))
def test_documented_default_is_the_default(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    default = getattr(Settings(), name)
    variable = f"ISODYN_{name.upper()}"
    monkeypatch.setenv(variable, documented()[variable].strip("`"))
    assert getattr(Settings(), name) == default


def test_environment_sets_and_types_are_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ISODYN_POOL", "threads")
    monkeypatch.setenv("ISODYN_LOG_LEVEL", "debug")
    monkeypatch.setenv("ISODYN_CORS_ORIGINS", '["https://a.example"]')
    settings = Settings()
    assert (settings.pool, settings.log_level) == (PoolKind.THREADS, LogLevel.DEBUG)
    assert settings.cors_origins == ("https://a.example",)


@pytest.mark.parametrize(
    ("variable", "value"),
    [("ISODYN_WORKERS", "0"), ("ISODYN_POOL", "ray"), ("ISODYN_PORT", "70000"), ("ISODYN_SHUTDOWN_GRACE_S", "-1")],
)
def test_what_does_not_fit_is_refused(variable: str, value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(variable, value)
    with pytest.raises(ValidationError, match=variable.removeprefix("ISODYN_").lower()):
        Settings()
