"""TensorBoard: curves over updates and, as a second run `by_frames`, over frames; the options as
hyper-parameters; a film of a failure."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from zipf.experiments.loggers.logger import LOGGERS, End, Logger, Start
from zipf.experiments.records.learned_options import affects_learning, flatten
from zipf.options import Options


class TensorBoardOptions(Options):
    """`film`: a run that has finished shows a failure in the rarest situation."""

    name: Literal["tensorboard"]
    film: bool


class TensorBoard(Logger):
    """Writes to the folder `tensorboard` in the run's."""

    def __init__(self, options: TensorBoardOptions):
        self.options = options
        self._of_finished: Any = None

    def on_start(self, run: Start) -> None:
        from torch.utils.tensorboard.summary import hparams

        # Of a run that goes on TensorBoard hides the points that are written again, by their steps.
        # So those whose steps are frames are in a folder of their own.
        folder = run.folder / "tensorboard"
        self._by_update = _Events(folder, 0 if run.is_new else run.update + 1)
        self._by_frames = _Events(folder / "by_frames", 0 if run.is_new else run.frames + 1)
        options = {
            name: value if isinstance(value, bool | int | float | str) else str(value)
            for name, value in flatten(dict(run.options)).items()
            if affects_learning(name) or name == "condition"
        }
        *described, self._of_finished = hparams(options, {f"score/{kind}": 0 for kind in run.kinds})
        for summary in described:
            self._by_update.write(step=0, summary=summary)

    def on_update(self, when: Mapping[str, float], metrics: Mapping[str, float]) -> None:
        self._scalars(when, "train", {**when, **metrics})

    def on_evaluation(self, when: Mapping[str, float], scores: Mapping[str, float]) -> None:
        self._scalars(when, "score", scores)

    def on_end(self, end: End) -> None:
        try:
            if end.finished:
                self._by_update.write(step=0, summary=self._of_finished)
                if self.options.film and (film := end.film()):
                    self._by_update.write(step=end.update, summary=_animation(film))
        finally:
            self._by_update.close()
            self._by_frames.close()

    def _scalars(self, when: Mapping[str, float], group: str, values: Mapping[str, float]) -> None:
        from tensorboard.compat.proto.summary_pb2 import Summary

        found = [Summary.Value(tag=f"{group}/{k}", simple_value=v) for k, v in values.items()]
        self._by_update.write(step=int(when["update"]), summary=Summary(value=found))
        self._by_frames.write(step=int(when["frames"]), summary=Summary(value=found))


class _Events:
    """A file of events. TensorBoard's own writer writes in a thread, where nobody sees that the
    disk is full."""

    def __init__(self, folder: Path, step: int):
        from tensorboard.compat.proto.event_pb2 import SessionLog
        from tensorboard.summary.writer.record_writer import RecordWriter

        folder.mkdir(parents=True, exist_ok=True)
        # Files are read in the order of their names, so they are numbered: the time of day may
        # stand still, or be set back.
        numbers = (path.name.rpartition(".")[2] for path in folder.iterdir())
        number = 1 + max((int(text) for text in numbers if text.isdecimal()), default=0)
        self._file = open(folder / f"events.out.tfevents.{number:08}", "xb")  # noqa: SIM115
        self._records = RecordWriter(self._file)
        self.write(file_version="brain.Event:2")
        # TensorBoard then hides points of this step and later ones that were written before.
        self.write(step=step, session_log=SessionLog(status=SessionLog.START))

    def write(self, **content: Any) -> None:
        from tensorboard.compat.proto.event_pb2 import Event

        self._records.write(Event(wall_time=time.time(), **content).SerializeToString())
        self._file.flush()

    def close(self) -> None:
        self._file.close()


def _animation(film: Path) -> Any:
    """A GIF as an image, which TensorBoard plays."""
    from PIL import Image
    from tensorboard.compat.proto.summary_pb2 import Summary

    with Image.open(film) as opened:
        width, height = opened.size
    image = Summary.Image(
        width=width, height=height, colorspace=3, encoded_image_string=film.read_bytes()
    )
    return Summary(value=[Summary.Value(tag="failure in the rarest situation", image=image)])


LOGGERS.register(TensorBoardOptions, TensorBoard)
