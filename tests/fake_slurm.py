"""Stands for sbatch, srun, sacct and scancel on a machine without SLURM: jobs are processes of this machine.

`install(folder)` writes the four commands into a folder, to be put in front of PATH. Jobs lie in `folder/jobs`: a file
for each, with the number of its process. As in SLURM, a job that is cancelled gets SIGTERM, with all below it.
"""

import os
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path

COMMANDS = ("sbatch", "srun", "sacct", "scancel")


def install(folder: Path) -> None:
    """Have the commands in `folder`."""
    (folder / "jobs").mkdir(parents=True)
    for name in COMMANDS:
        (folder / name).write_text(f'#!/bin/sh\nexec "{sys.executable}" "{__file__}" {name} "{folder / "jobs"}" "$@"\n')
        (folder / name).chmod(0o755)


def sbatch(jobs: Path, script: str) -> None:
    """Start the tasks of an array, or one job, by what the script says in its #SBATCH lines."""
    text = Path(script).read_text()
    said = dict(
        shlex.split(line)[0].removeprefix("--").split("=", 1) for line in re.findall(r"^#SBATCH (.*=.*)$", text, re.M)
    )
    number = 100 + len({path.name.split("_")[0] for path in jobs.iterdir()})
    array = said.get("array")
    first, last = map(int, array.split("%")[0].split("-")) if array else (0, 0)
    for task in range(first, last + 1):
        about = {"SLURM_JOB_ID": str(1000 + task), "SLURM_ARRAY_JOB_ID": str(number), "SLURM_ARRAY_TASK_ID": str(task)}
        about |= {"SLURM_ARRAY_TASK_COUNT": str(last - first + 1)} if array else {}
        about = about if array else {"SLURM_JOB_ID": str(number)}
        about |= {"SLURM_NTASKS": "1", "SLURM_JOB_NUM_NODES": "1", "SLURM_NODEID": "0", "SLURM_PROCID": "0"}
        about |= {
            "SLURM_LOCALID": "0",
            "SLURM_JOB_NODELIST": "here",
            "SLURM_CPUS_PER_TASK": said.get("cpus-per-task", "1"),
        }
        log = open(jobs.parent / f"job-{number}_{task}.log", "wb")  # noqa: SIM115
        job = subprocess.Popen(
            ["bash", script],
            env=os.environ | about,
            stdout=log,
            stderr=log,
            stdin=subprocess.DEVNULL,
            start_new_session=True,
        )
        (jobs / (f"{number}_{task}" if array else str(number))).write_text(str(job.pid))
    print(f"Submitted batch job {number}")


def srun(jobs: Path, *words: str) -> None:
    """Run what comes after the options."""
    command = list(words[words.index(next(one for one in words if Path(one).name.startswith("python"))) :])
    os.execvp(command[0], command)


def sacct(jobs: Path, *words: str) -> None:
    """Tell of every job whether it runs."""
    print("JobID|State|NodeList")
    for path in sorted(jobs.iterdir()):
        print(f"{path.name}|{'RUNNING' if runs(int(path.read_text())) else 'COMPLETED'}|here")


def scancel(jobs: Path, *words: str) -> None:
    """End jobs, and note that it was asked for."""
    for job in words:
        (jobs.parent / f"cancelled-{job}").touch()
        try:
            os.killpg(int((jobs / job).read_text()), signal.SIGTERM)
        except ProcessLookupError:
            continue


def runs(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


if __name__ == "__main__":
    globals()[sys.argv[1]](Path(sys.argv[2]), *sys.argv[3:])
