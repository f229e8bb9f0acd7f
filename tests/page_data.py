"""What a report's page draws, read back from it."""

from __future__ import annotations

import json
import re
from typing import Any


def page_data(page: str) -> dict[str, Any]:
    """As `report_data` gave it: what all shifts share, and each shift from its own element."""
    found = {
        name: json.loads(text)
        for name, text in re.findall(
            r"<script type='application/json' id='data(.*?)'>(.*?)</script>", page, re.DOTALL
        )
    }
    data: dict[str, Any] = found.pop("")
    assert list(found) == [f"-{key}" for key in data["shifts"]]
    return data | {"shifts": {key: found[f"-{key}"] for key in data["shifts"]}}
