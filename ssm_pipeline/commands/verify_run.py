"""`workflow verify`: is every file of a run still what was written? By content, not by size."""

from __future__ import annotations

from pathlib import Path

from ssm_pipeline.counting import counted
from ssm_pipeline.engine.left_files import damaged_files, undo
from ssm_pipeline.engine.ownership import alone_in
from ssm_pipeline.engine.stage import StageRecord
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.records import DamagedFile, StudyError


def verify_run(run_folder: Path, terminal: Terminal, remove: bool = False) -> bool:
    """True if every file of every finished stage is as it was written.

    Args:
        remove: Deletes what is not, so that the next run makes it again; without it nothing is
            changed. Raises StudyError if the folder holds no run, or one that is running.
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
                damaged.append(DamagedFile(folder / "stage.json", "is no record of a stage"))
            elif not record.files:
                terminal.detail(f"{folder.name}: made before hashes were kept; not looked at")
            else:
                files, looked_at = files + len(record.files), looked_at + 1
                damaged += damaged_files(folder, record.files, by_content=True)
            steps.advance_to(number)
        for error in damaged:
            terminal.detail(f"{error.path} {error.found}")
            if remove:
                undo(error.path, run_folder)
    if not damaged:
        terminal.say(
            f"{run_folder}: {counted(files, 'file')} of {looked_at} of {len(stages)} stages and "
            f"what "
            "their cases left are as they were written"
        )
    elif remove:
        terminal.say(f"{len(damaged)} damaged files deleted; the next run makes them again")
    else:
        terminal.say(
            f"{len(damaged)} damaged files. To have them made again: workflow verify "
            f"{run_folder} --remove, and the same run as before"
        )
    return not damaged
