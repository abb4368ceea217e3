"""`Export`: a policy for other programs."""

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maidenflight import manifest, names, results, run_folder
from maidenflight.deployment import choose_folder, export, keywords_of
from maidenflight.errors import InputError
from maidenflight.inputs import StrPath
from maidenflight.registry import EXPORTERS
from maidenflight.settings import REQUIRED, choice, name_of, path, setting
from maidenflight.verb import Output, Progress, Result, Verb
from maidenflight.verbs import shared

if TYPE_CHECKING:
    from maidenflight.policy_file import PolicyFile


class Export(Verb):
    """Export a POLICY file to C, ONNX or a Crazyflie app.

    The policy is ours or of Gronauer et al., whose JSON can be written too.
    """

    output = Output(
        None,
        "Folder; "
        + ", ".join(f"{choose_folder(to)} for {to}" for to in EXPORTERS.own)
        + " by default.",
    )

    policy: Path = setting(path("a policy file"), REQUIRED, argument=True, files=True)
    to: str = setting(
        name_of(EXPORTERS),
        "c",
        "c: C99 without dependencies, policy.h and policy.c; onnx: policy.onnx; authors: a JSON as "
        "the tools of Gronauer et al. read it; crazyflie: an app that builds beside an unmodified "
        "Crazyflie firmware; raptor: policy.h5 and, for PX4, policy.tar, of a policy "
        "trained with --form raptor; px4: the network of PX4's mc_nn_control, of one trained with "
        "--form px4.",
    )
    control: str | None = shared.control_of_authors()
    propellers: str | None = setting(
        choice(*names.PROPELLERS),
        None,
        "Of the drone, for crazyflie: the firmware compensates the battery by them; 2.1+ unless "
        "given.",
    )
    seed: int = shared.seed()

    def choose_output(self, output: StrPath | None) -> Path:
        """Returns the folder; the exporter's own by default."""
        return Path(choose_folder(self.to) if output is None else output)

    def check_early(self) -> None:
        """Refuses propellers where nothing depends on them."""
        if self.propellers is not None and "propellers" not in keywords_of(self.to):
            raise InputError(
                f"--propellers: --to {self.to} does not depend on the propellers; leave it out."
            )

    def _propellers(self, file: "PolicyFile") -> str:
        """Those given, else those of the policy's drone; empty where neither says."""
        from maidenflight.identification import identity

        own = identity.propellers_of(file.identity)
        if self.propellers is not None and own not in ("", self.propellers):
            raise InputError(
                f"--propellers {self.propellers}: {self.policy} was trained for a drone identified "
                f"with {own}. Identify yours with its --battery-law, and train."
            )
        return self.propellers or own

    def compute(self, output: Path, progress: Progress) -> Result:
        """Writes the policy for other programs.

        Raises:
            InputError: the file is no policy, or one of ours of another structure; or what is
                written cannot hold it, or not fly the frame that it was trained for.
        """
        from maidenflight.deployment.frame import read_for

        file = read_for(self.policy, self.to, self.control)
        interface, rotors = file.interface, file.rotors
        record = self.make_record([self.policy], policy=None, control=interface.name, rotors=rotors)
        if "seed" not in keywords_of(self.to):
            record.pop("seed")
        options: dict[str, Any] = {"name": self.policy.stem, "hover": file.hover}
        options |= {"seed": self.seed, "record": record}
        propellers = self._propellers(file)
        options |= {"propellers": propellers} if propellers else {}
        written = export(file.policy, output, self.to, **options)
        home = self.policy.parent
        home = home.parent if home.name == run_folder.POLICIES else home
        run = None
        with suppress(InputError):  # a damaged manifest costs no export
            run = manifest.find_manifest(home)
        return Result(
            content={"files": [str(path) for path in written]},
            written={"exported": written},
            read={"policies": [self.policy]},
            record=record,
            notes=[*file.doubts, *(_bad_verdict(run, self.policy) if run else [])],
            next=("report", home) if run else ("report", "--policies", self.policy),
            value=written,
        )


def _bad_verdict(run: manifest.Manifest, policy: Path) -> list[str]:
    """Returns what the last prediction of a run says of a policy, where that is bad."""
    own, last = results.digest(policy), {}
    for entry in run.entries:
        for file in run.files(entry, "prediction"):
            verdicts = results.read_record(file).get("verdicts")
            for verdict in verdicts if isinstance(verdicts, list) else ():
                if isinstance(verdict, dict) and verdict.get("policy") == own:
                    last = {"file": file, **verdict}
    return [f"{last['file']}: {last.get('sentence')}"] if last.get("good") is False else []
