"""A page as a browser without any network has it."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from patience import HANG_S

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


def browse(
    url: str, folder: Path, milliseconds: int = 5000, width: int = 1400
) -> tuple[str, list[str]]:
    """The page after so much of the browser's own time, and what its console said. A browser makes
    no window narrower than 500."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        pytest.skip(f"no browser to open the page in: none of {', '.join(BROWSERS)} is here")
    done = subprocess.run(
        [
            browser, "--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr",
            f"--user-data-dir={folder / 'profile'}", "--host-resolver-rules=MAP * ~NOTFOUND",
            f"--virtual-time-budget={milliseconds}", f"--window-size={width},2400",
            "--dump-dom", url,
        ],
        capture_output=True, text=True, timeout=HANG_S, check=True,
    )  # fmt: skip
    return done.stdout, [line for line in done.stderr.splitlines() if "CONSOLE" in line]
