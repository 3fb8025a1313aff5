"""Which methods can be run as printed."""

import pytest

from midspan.errors import UsageError
from midspan.settings.load import validate


@pytest.mark.parametrize(("method", "fine"), [("smoother", False), ("lag", False), ("adaptive-kalman", True)])
def test_literal_is_refused_where_there_is_no_printed_form(method, fine):
    tree = {
        "accelerometer": {"file": "a.csv"},
        "displacement": {"file": "d.csv"},
        "fusion": {"method": method, "literal": True},
    }
    if fine:
        assert validate(tree, "recording.toml").fusion.literal
        return
    with pytest.raises(UsageError, match=f"adaptive-kalman.*received method = '{method}'"):
        validate(tree, "recording.toml")
