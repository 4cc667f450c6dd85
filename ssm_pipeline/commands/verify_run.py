"""`workflow verify`: check that no file of a run has changed, by content."""

from __future__ import annotations

from pathlib import Path

from ssm_pipeline.counting import counted
from ssm_pipeline.engine.left_files import damaged_files, undo
from ssm_pipeline.engine.ownership import alone_in
from ssm_pipeline.engine.stage import StageRecord
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.records import DamagedFile, StudyError
from ssm_pipeline.runs.former_results import former_results


def verify_run(run_folder: Path, terminal: Terminal, remove: bool = False) -> bool:
    """Return True if no file of any finished stage has changed since it was written.

    Args:
        remove: Whether to delete changed files, so that the next run makes them again.

    Raises:
        StudyError: If the folder holds no run, or another process is writing to it.
    """
    stages = sorted(path.parent for path in run_folder.glob("*/stage.json"))
    if not stages:
        raise StudyError(f"{run_folder} holds no run; give a folder such as runs/luna16.")
    damaged: list[DamagedFile] = []
    files, looked_at = 0, 0
    with alone_in(run_folder), terminal.steps("stages", len(stages)) as steps:
        for number, folder in enumerate(stages, start=1):
            record = StageRecord.read(folder)
            if record is None:
                damaged.append(DamagedFile(folder / "stage.json", "is not a stage's record"))
            elif not record.files:
                terminal.detail(f"{folder.name}: not checked, as its record has no hashes")
            else:
                files, looked_at = files + len(record.files), looked_at + 1
                damaged += damaged_files(folder, record.files, by_content=True)
            steps.advance_to(number)
        for error in damaged:
            terminal.detail(f"{error.path} {error.found}")
            if remove:
                undo(error.path, run_folder)
    if not damaged:
        for line in former_results(run_folder):
            terminal.detail(line)
        terminal.say(
            f"{run_folder}: {counted(files, 'file')} of {looked_at} of "
            f"{counted(len(stages), 'stage')} and of their cases are unchanged"
        )
    elif remove:
        terminal.say(
            f"{counted(len(damaged), 'damaged file')} deleted; the next run will make "
            f"{'it' if len(damaged) == 1 else 'them'} again"
        )
    else:
        terminal.say(
            f"{counted(len(damaged), 'damaged file')} found. To repair the run, call: workflow "
            f"verify {run_folder} --remove, then run the study again"
        )
    return not damaged
