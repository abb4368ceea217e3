"""What a user sees of a training: its bar, its lines, and the loggers of its scores."""

from typing import TYPE_CHECKING

from maidenflight.verb import Progress

if TYPE_CHECKING:
    from maidenflight.training.loggers import Listener
    from maidenflight.training.scores import Scores
    from maidenflight.training.train import Progress as Training


class TrainingWatch:
    """Listens to a training, which ends in flights, and whose updates may then become more."""

    def __init__(self, scores: "Scores", show: "Listener", progress: Progress) -> None:
        self._scores, self._show, self._progress = scores, show, progress
        self._line, self._end = "training, before the first score", 0

    def begin(self, updates: int) -> None:
        """Begins to count to so many updates."""
        if not self._end:
            self._progress.move(0, updates, "compiling")
            self._progress.log(f"update 0 of {updates}: compiling")
        self._end = updates

    def on_update(self, done: int, of: int) -> None:
        """Moves the bar."""
        self._progress.move(done, of, self._line)

    def on_progress(self, now: "Training") -> None:
        """Adds a score, unless it is known, and shows it."""
        if self._scores.has(now):
            return
        self._show(now)
        self._line = self._scores.add(now)
        self.on_update(now.update, self._end)
        self._progress.log(f"update {now.update} of {self._end}: {self._line}")
        if now.update == self._end:
            self._progress.move(self._end, self._end, "flying the drone and others about it")
