"""Stores to try: SQLite in a folder; the database of a PostgreSQL server where one is installed."""

import secrets

import pytest


@pytest.fixture(params=["sqlite", "postgresql"])
def store_at(request, tmp_path):
    """Where an empty store can be made."""
    if request.param == "sqlite":
        return str(tmp_path / "store")
    return request.getfixturevalue("postgres").database(f"store_{secrets.token_hex(6)}")


@pytest.fixture
def store_name():
    """The name of a database that there is not yet."""
    return f"store_{secrets.token_hex(6)}"
