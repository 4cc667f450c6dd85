from __future__ import annotations

import pytest
from synthetic_report import make_content

from ssm_pipeline.report.content import ReportContent


@pytest.fixture(scope="session")
def content() -> ReportContent:
    return make_content()
