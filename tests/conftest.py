"""Shapes and types of every annotated function are checked at run time; the tests run in double precision on all cores."""

import pytest
from jaxtyping import install_import_hook

install_import_hook("railjax", "beartype.beartype")

import railjax  # noqa: E402

railjax.use_double_precision()
railjax.use_all_cores()


@pytest.fixture(scope="session")
def coach() -> railjax.Vehicle:
    return railjax.load_vehicle("coach")


@pytest.fixture(scope="session")
def literal() -> railjax.Vehicle:
    return railjax.load_vehicle("coach-table1")


@pytest.fixture(scope="session")
def smooth(coach: railjax.Vehicle) -> railjax.Vehicle:
    return railjax.replace(coach, contact__law="smooth")
