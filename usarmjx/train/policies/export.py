"""Export of a run's policy: as a file for NumPy, as an ONNX model, or as a folder with a card."""

import json
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.base.registry import unknown_name
from usarmjx.train.policies import POLICIES
from usarmjx.train.policies.policy_file import (
    SUFFIX,
    WEIGHTS,
    NumpyPolicy,
    check_place,
    read_arrays,
    save_policy,
    write_arrays,
    write_folder,
)
from usarmjx.train.task_names import newest_name


def export_run(run: str | Path, file: str | Path, which: str = "best", half: bool = False) -> None:
    """Write the policy of a run, or a packaged one, to a file.

    Args:
        run: Folder of the run; or, where there is none of that name, the task of a packaged policy.
        file: To write, .npz or .onnx; or a folder of that suffix, .policy.
        which: Checkpoint: `best`, `last`, or the number of an iteration.
        half: See `save_policy`.

    Raises:
        UsageError: No run, no such checkpoint, a broken one, a file of another kind, or one that cannot be
            written.
    """
    suffix = Path(file).suffix.lower()
    if suffix == ".onnx":
        # Here: the module needs the extra onnx, which the other kinds of files do without.
        from usarmjx.train.policies.onnx_file import write_onnx

        # By way of a file for NumPy, so that both kinds hold the same rounded weights.
        with TemporaryDirectory() as folder:
            export_run(run, Path(folder) / WEIGHTS, which, half)
            write_onnx(NumpyPolicy(Path(folder) / WEIGHTS), Path(file))
        return
    if suffix == SUFFIX:
        # Before the export, which starts JAX to read a run: a wrong place is refused at once.
        check_place(Path(file))
        with TemporaryDirectory() as folder:
            export_run(run, Path(folder) / WEIGHTS, which, half)
            write_folder(Path(folder) / WEIGHTS, Path(file))
        return
    if suffix != ".npz":
        raise UsageError(
            f"{file}: a policy is written as .npz or .onnx, not as {Path(file).suffix or 'a bare name'};"
            " .policy makes a folder with a card"
        )
    # A folder comes first: a run may be named as a task is.
    if not Path(run).exists() and (name := newest_name(str(run))) in POLICIES:
        about, arrays = read_arrays(POLICIES.get(name))
        # Written anew, not copied: another precision may be asked for.
        write_arrays(file, {"about": np.array(json.dumps(about)), **arrays}, half)
        return
    if not Path(run).exists():
        raise UsageError(unknown_name("run or packaged policy", str(run), POLICIES.names()))
    # Only runs need JAX to be read.
    from usarmjx.train.learning.checkpoint import read_policy

    save_policy(file, *read_policy(Path(run), which), half=half)
