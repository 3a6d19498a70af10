"""Replacements for sbatch, srun, sacct and scancel on a machine without SLURM, where jobs are local processes.

`install(folder)` writes the four commands into a folder to put in front of PATH. `folder/jobs` holds a file per job
with the number of its process. As in SLURM, a cancelled job and all its children receive SIGTERM."""

import os
import re
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
    """Start a job according to the #SBATCH lines of the script."""
    cores = re.search(r"^#SBATCH --cpus-per-task=(\d+)", Path(script).read_text(), re.MULTILINE)
    number = 100 + len(list(jobs.iterdir()))
    variables = {"SLURM_JOB_ID": number, "SLURM_NTASKS": 1, "SLURM_JOB_NUM_NODES": 1, "SLURM_JOB_NODELIST": "here"}
    variables |= {"SLURM_NODEID": 0, "SLURM_PROCID": 0, "SLURM_LOCALID": 0}
    variables |= {"SLURM_CPUS_PER_TASK": cores[1] if cores else 1}
    with open(jobs.parent / f"job-{number}.log", "wb") as log:
        environment = os.environ | {name: str(value) for name, value in variables.items()}
        files = {"stdin": subprocess.DEVNULL, "stdout": log, "stderr": log}
        job = subprocess.Popen(["bash", script], env=environment, start_new_session=True, **files)
    (jobs / str(number)).write_text(str(job.pid))
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
