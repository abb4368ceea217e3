"""`Record`: flight logs of a simulated drone."""

from pathlib import Path
from typing import Any

from maidenflight import names, run_folder
from maidenflight.errors import InputError
from maidenflight.settings import choice, number, path, setting, whole
from maidenflight.verb import Output, Progress, Result, Verb
from maidenflight.verbs import shared


class Record(Verb):
    """Record flights of a simulated drone.

    The firmware's position PID or --controller flies it, or a --plan of maidenflight plan. fly
    records a real drone.
    """

    output = Output("flights", "Folder for the logs.")

    reality: str | None = setting(
        shared.REALITY,
        None,
        f"What flies: {shared.REALITIES}.",
        shared.FLIGHTS,
        usual="virtual:7, or the drone of the plan",
        files=True,
    )
    flights: int | None = setting(
        whole(1, 999), None, "How many flights; 4 by default, 1 of a plan."
    )
    duration: float = setting(number(2.0, 600.0), 30.0, "Seconds of each, but of a plan.")
    excitation: float = setting(
        number(0.0, 0.3),
        0.06,
        "Random thrust on each motor, as a share of full thrust; it makes lag and latency visible. "
        "0: plain PID.",
    )
    plan: Path | None = setting(
        path("a plan", "FILE"), None, "Fly this plan of maidenflight plan instead.", files=True
    )
    rate: int = shared.rate()
    controller: str = setting(
        choice(*names.CONTROLLERS), "pid", "Controller of the firmware that flies."
    )
    firmware: str = shared.firmware(
        "Firmware whose PID flies and compensates for the battery: that of the paper's flights, or "
        "today's, which lets thrust commands exceed 1."
    )
    accept_bounds: bool = shared.accept_bounds()
    seed: int = shared.seed()

    def check_early(self) -> None:
        """Refuses what a plan settles."""
        settled = ("duration", "controller", "excitation") if self.plan else ()
        shared.must_be_default(self, settled, "the plan defines the flight")

    def compute(self, output: Path, progress: Progress) -> Result:
        """Flies; writes a CSV a flight, and the true parameters where they are known."""
        from maidenflight.experiments import drones
        from maidenflight.flights import flight_plan
        from maidenflight.flying import recording
        from maidenflight.identification.drone_file import DroneFile
        from maidenflight.parameters import Parameters
        from maidenflight.verbs.parts import logs_output

        progress.move(0, None, "compiling and flying")
        plan = None if self.plan is None else flight_plan.read(self.plan)
        planned = {} if plan is None else plan.record.get("settings", {})
        name = self.reality or str(planned.get("drone", "virtual:7"))
        if self.reality is None and shared.REALITY.names_code(name):
            raise InputError(
                f"{self.plan}: made for {name}, Python code that anybody may have written. Look at "
                f"it, and give --reality {name} if you mean it."
            )
        drone = drones.find_reality(name, self.accept_bounds)
        count = self.flights or (4 if plan is None else 1)
        seconds = self.duration if plan is None else plan.seconds
        settled: dict[str, Any] = {"reality": drone.name, "flights": count}
        if plan is not None:
            settled |= {"duration": seconds, "controller": None, "excitation": None}
            how = self.key, count, self.rate, self.firmware
            recorded = recording.record_plan(drone, plan, *how)
        else:
            recorded = recording.record(
                *(drone, self.key, count, seconds, self.excitation),
                rate=self.rate,
                firmware=self.firmware,
                controller=self.controller,
            )
        plans = shared.own_files(self.plan)
        record = self.make_record(plans, **settled)
        logs = logs_output.write_logs(output, {flight.name: flight for flight in recorded}, record)
        truth, own = output / run_folder.REALITY, getattr(drone, "parameters", None)
        if isinstance(own, Parameters):
            DroneFile(own, record=record).write(truth)
        else:
            truth.unlink(missing_ok=True)
        truth_files = [truth] if truth.exists() else []
        remark = f"; the true parameters are in {truth.name}" if truth_files else ""
        return Result(
            content={
                "flights": [str(path) for path in logs],
                "truth": str(truth) if truth_files else None,
                "simulated": True,
            },
            summary=[f"{count} simulated flight{'s' * (count > 1)} of {seconds:g} s{remark}"],
            written={"logs": logs, "truth": truth_files},
            read={"plan": plans},
            record=record,
            rows=[{"flight": flight.name, "seconds": flight.duration} for flight in recorded],
            next=("identify", output),
            value=recorded,
        )
