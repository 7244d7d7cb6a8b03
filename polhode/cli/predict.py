"""``polhode predict``: the motion of the target after the last stereo pair."""

from pathlib import Path
from typing import Annotated

from polhode.cli.answer import Answer
from polhode.cli.options import Command, Named, Positional


class PredictCommand(Command):
    """Predict the target's motion: its last state propagated as a free rigid body, with standard deviations.

    Prints a few rows of position, velocity, attitude and rate; -o writes all rows, with the columns of
    trajectory.csv. Where the images leave more than one rotation, FILE_2 and so on hold the other hypotheses.
    """

    run: Annotated[Path, Positional("RUN")]
    """Folder of a finished run."""
    horizon_s: Annotated[float, Named("S", "--horizon")]
    """Time to predict beyond the last stereo pair [s]."""
    output: Annotated[Path | None, Named("FILE", "-o")] = None
    """Table, CSV; with the suffix .npz an archive with the full covariances. An earlier prediction is
    replaced, any other file is not."""
    step_s: Annotated[float | None, Named("S")] = None
    """Time between two rows [s]; the run's own interval unless given."""
    marks: bool = False
    """Give the standard deviations of the body itself: the estimated centre of mass and principal axes are
    treated as marks on it. They are finite even where the motion does not determine those. States are the
    same."""

    def execute(self) -> Answer:
        """Predict, write and print."""
        from polhode.planning.predict import (
            files_of_hypotheses,
            format_prediction,
            predict_run,
            prediction_file,
            write_prediction,
        )
        from polhode.runtime.console import choose_progress

        files = [] if self.output is None else files_of_hypotheses(self.output, self.run)
        places = [prediction_file(file, self.run) for file in files]
        progress = choose_progress()
        prediction = predict_run(self.run, self.horizon_s, self.step_s, progress=progress)
        table = format_prediction(prediction, bool(places), self.marks)
        figures = {
            "rows": len(prediction.time_s),
            "last": {
                name: getattr(prediction, name)[-1]
                for name in ("time_s", "timestamps_ns", "r_N", "v_N", "R_NP", "w_P")
            },
            "undetermined": prediction.undetermined,
        }
        for number, place in enumerate(places, 1):
            if number > 1:
                prediction = predict_run(
                    self.run, self.horizon_s, self.step_s, progress=progress, hypothesis=number
                )
            write_prediction(prediction, place, self.marks)
        if not places:
            return Answer(table, figures=figures)
        others = f"Other hypotheses: {', '.join(map(str, files[1:]))}" if len(files) > 1 else ""
        return Answer(
            f"Prediction: {self.output}",
            "\n\n".join(filter(None, [table, others])),
            paths=tuple(files),
            figures=figures,
        )
