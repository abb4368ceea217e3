"""A study by a real SLURM of two nodes on this machine, beside the same study on `local`.

    apt-get install slurmctld slurmd slurm-client munge
    python benchmarks/slurm_two_nodes.py [--study STUDY.toml]

Starts munged, slurmctld and two slurmd in a folder for temporary files, as root, runs the study,
compares the bytes of the tables, and ends all of them, whatever happens. Without a study it takes
one of short tasks. One of its jobs is cancelled while it runs, as by a node that fails.
"""

import argparse
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

from maidenflight.errors import require_packages
from maidenflight.settings import setting, whole
from maidenflight.verb import Progress, Result, Verb

PORTS = {"ctld": 46817, "n1": 46818, "n2": 46819}
LONGEST_S = 480
STUDY = """
[[task]]
name = "numbers"
kind = "slurm_two_nodes:Third"
grid = { value = { first = 1, count = 8 } }
"""
CONFIGURATION = """
ClusterName=two
SlurmctldHost={host}
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket={place}/munge.socket
SlurmctldPort={ctld}
StateSaveLocation={place}/state
SlurmdSpoolDir={place}/spool-%n
SlurmctldPidFile={place}/slurmctld.pid
SlurmdPidFile={place}/slurmd-%n.pid
SlurmctldLogFile={place}/slurmctld.log
SlurmdLogFile={place}/slurmd-%n.log
ProctrackType=proctrack/pgid
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
MpiDefault=none
ReturnToService=2
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SchedulerParameters=sched_interval=1,batch_sched_delay=0
JobRequeue=0
NodeName=n1 NodeHostname={host} Port={n1} CPUs=1 RealMemory=1000 State=UNKNOWN
NodeName=n2 NodeHostname={host} Port={n2} CPUs=1 RealMemory=1000 State=UNKNOWN
PartitionName=all Nodes=n1,n2 Default=YES MaxTime=INFINITE State=UP
"""


class Third(Verb):
    """Divides a number by three."""

    value: int = setting(whole(1, 100))

    def compute(self, output: Path, progress: Progress) -> Result:
        """Divides; writes nothing."""
        time.sleep(2)
        return Result(rows=[{"third": self.value / 3}])


def begin(cluster: ExitStack, place: Path, *words: str) -> None:
    """Starts a daemon in the foreground, which ends with the rest."""
    log = cluster.enter_context((place / f"{Path(words[0]).name}.out").open("a"))
    daemon = subprocess.Popen(words, stdout=log, stderr=subprocess.STDOUT, start_new_session=True)

    def end() -> None:
        daemon.send_signal(signal.SIGTERM)
        try:
            daemon.wait(10)
        except subprocess.TimeoutExpired:
            daemon.kill()

    cluster.callback(end)


def start(cluster: ExitStack, place: Path) -> None:
    """Starts the cluster, and waits until both nodes are idle."""
    host = socket.gethostname()
    for name in ("state", "spool-n1", "spool-n2"):
        (place / name).mkdir()
    (place / "slurm.conf").write_text(CONFIGURATION.format(place=place, host=host, **PORTS))
    key = place / "munge.key"
    key.write_bytes(os.urandom(128))
    key.chmod(0o400)
    os.environ["SLURM_CONF"] = str(place / "slurm.conf")
    os.environ["PATH"] = os.pathsep.join([os.environ["PATH"], "/usr/sbin"])
    own = [
        f"--{what}={place}/munge.{what}" for what in ("socket", "log-file", "pid-file", "seed-file")
    ]
    begin(cluster, place, "munged", "--foreground", "--force", f"--key-file={key}", *own)
    time.sleep(1)
    begin(cluster, place, "slurmctld", "-D")
    for name in ("n1", "n2"):
        begin(cluster, place, "slurmd", "-D", "-N", name)
    until = time.monotonic() + 60
    while time.monotonic() < until:
        command = ["sinfo", "--noheader", "--format=%T %D"]
        states = subprocess.run(command, capture_output=True, text=True, timeout=20).stdout
        if states.split() == ["idle", "2"]:
            return
        time.sleep(1)
    for log in sorted(place.glob("*.log")) + sorted(place.glob("*.out")):
        print(f"{log.name}:\n{log.read_text()[-2000:]}", file=sys.stderr)
    sys.exit("the nodes did not become idle")


def sweep(study: Path, output: Path, on: str) -> subprocess.Popen[bytes]:
    """Begins the command."""
    words = ["sweep", str(study), "--trust", "-o", str(output), "--on", on]
    return subprocess.Popen([sys.executable, "-m", "maidenflight", *words])


def cancel_one() -> bool:
    """Cancels a job that runs, if there is one."""
    command = ["squeue", "--noheader", "--states=R", "--format=%i"]
    jobs = subprocess.run(command, capture_output=True, text=True, timeout=20).stdout.split()
    if jobs:
        subprocess.run(["scancel", jobs[0]], check=True, timeout=20)
    return bool(jobs)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--study", type=Path)
    arguments = options.parse_args()
    require_packages("submitit")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("ended"))
    places = [str(Path(__file__).parent), *filter(None, [os.environ.get("PYTHONPATH")])]
    os.environ["PYTHONPATH"] = os.pathsep.join(places)
    with ExitStack() as cluster:
        place = Path(cluster.enter_context(tempfile.TemporaryDirectory(prefix="two-")))
        study = arguments.study or place / "study.toml"
        if arguments.study is None:
            study.write_text(STUDY)
        start(cluster, place)
        print("two nodes are idle", flush=True)
        began = time.monotonic()
        driver = sweep(study, place / "slurm", "slurm")
        cluster.callback(driver.kill)
        cancelled = False
        while driver.poll() is None and time.monotonic() - began < LONGEST_S:
            cancelled = cancelled or cancel_one()
            time.sleep(1)
        way = "one job was cancelled" if cancelled else "no job was cancelled"
        print(
            f"slurm: exit code {driver.poll()}, {time.monotonic() - began:.0f} s; {way}", flush=True
        )
        if sweep(study, place / "local", "local").wait(LONGEST_S) or driver.poll():
            sys.exit("a study failed")
        tables = [(place / name / "study.csv").read_bytes() for name in ("slurm", "local")]
        print(
            f"the tables are {'the same' if len(set(tables)) == 1 else 'DIFFERENT'}, byte for byte"
        )
        sys.exit(len(set(tables)) - 1)


if __name__ == "__main__":
    main()
