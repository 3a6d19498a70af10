"""Replacements for sbatch, srun, sacct and scancel on a machine without SLURM, where jobs are local processes.

`install(folder)` writes the four commands into a folder to put in front of PATH. `folder/jobs` holds a file per job
with the number of its process. As in SLURM, a cancelled job and all its children receive SIGTERM.
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
    """Write the commands into `folder`."""
    (folder / "jobs").mkdir(parents=True)
    for name in COMMANDS:
        (folder / name).write_text(f'#!/bin/sh\nexec "{sys.executable}" "{__file__}" {name} "{folder / "jobs"}" "$@"\n')
        (folder / name).chmod(0o755)


def sbatch(jobs: Path, script: str) -> None:
    """Start the tasks of an array, or a single job, according to the #SBATCH lines of the script."""
    text = Path(script).read_text()
    options = dict(
        shlex.split(line)[0].removeprefix("--").split("=", 1) for line in re.findall(r"^#SBATCH (.*=.*)$", text, re.M)
    )
    number = 100 + len({path.name.split("_")[0] for path in jobs.iterdir()})
    array = options.get("array")
    first, last = map(int, array.split("%")[0].split("-")) if array else (0, 0)
    for task in range(first, last + 1):
        variables = {
            "SLURM_JOB_ID": str(1000 + task),
            "SLURM_ARRAY_JOB_ID": str(number),
            "SLURM_ARRAY_TASK_ID": str(task),
        }
        variables |= {"SLURM_ARRAY_TASK_COUNT": str(last - first + 1)} if array else {}
        variables = variables if array else {"SLURM_JOB_ID": str(number)}
        variables |= {"SLURM_NTASKS": "1", "SLURM_JOB_NUM_NODES": "1", "SLURM_NODEID": "0", "SLURM_PROCID": "0"}
        variables |= {
            "SLURM_LOCALID": "0",
            "SLURM_JOB_NODELIST": "here",
            "SLURM_CPUS_PER_TASK": options.get("cpus-per-task", "1"),
        }
        log = open(jobs.parent / f"job-{number}_{task}.log", "wb")  # noqa: SIM115
        job = subprocess.Popen(
            ["bash", script],
            env=os.environ | variables,
            stdout=log,
            stderr=log,
            stdin=subprocess.DEVNULL,
            start_new_session=True,
        )
        (jobs / (f"{number}_{task}" if array else str(number))).write_text(str(job.pid))
    print(f"Submitted batch job {number}")


def srun(jobs: Path, *words: str) -> None:
    """Run the command that follows the options."""
    command = list(words[words.index(next(word for word in words if Path(word).name.startswith("python"))) :])
    os.execvp(command[0], command)


def sacct(jobs: Path, *words: str) -> None:
    """Print whether each job runs."""
    print("JobID|State|NodeList")
    for path in sorted(jobs.iterdir()):
        print(f"{path.name}|{'RUNNING' if runs(int(path.read_text())) else 'COMPLETED'}|here")


def scancel(jobs: Path, *words: str) -> None:
    """Terminate jobs and record the cancellation."""
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
