"""`workflow report`: a finished run's page, written again or under pseudonyms."""

from __future__ import annotations

from pathlib import Path

from ssm_pipeline import storage
from ssm_pipeline.commands.pseudonyms import pseudonyms_of
from ssm_pipeline.records import StudyError
from ssm_pipeline.report.settings import ReportSettings
from ssm_pipeline.runs.run import load_run
from ssm_pipeline.stages.report import page_content, renew_report
from ssm_pipeline.study.yaml_settings import checked_as

FOLDER = "report-pseudonymised"


def write_report_page(run_folder: Path, pseudonymise: bool) -> Path:
    """Write the page of a finished run and return its path.

    Args:
        run_folder: The run's folder.
        pseudonymise: Write a second page that shows case_001 … in place of the case ids. The key
            stays in the run's folder.

    Raises:
        StudyError: If the folder holds no finished run.
    """
    run = load_run(run_folder)
    stored = run.settings["report"]
    settings = checked_as(ReportSettings, stored, run_folder / "study.yaml")
    if not pseudonymise:
        path = renew_report(run, settings)
        if path is None:
            raise StudyError(f"{run_folder} holds no report; make it with: workflow run")
        return path
    from ssm_pipeline.report.renaming import renamed_html

    content = page_content(run, settings)
    names = pseudonyms_of(sorted(content.names), run_folder)
    path = run_folder / FOLDER / "index.html"
    storage.write_text(path, renamed_html(content, names, settings))
    return path
