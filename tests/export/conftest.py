from __future__ import annotations

import pytest
from posed_spheres import Spheres, posed_spheres


@pytest.fixture(scope="session")
def spheres() -> Spheres:
    return posed_spheres()
