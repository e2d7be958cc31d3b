"""Slurm's commands as scripts, as far as submitit uses them: the tasks of an array are processes of this machine.

What they cannot show: queues, other machines, Slurm's own limits.
"""

from __future__ import annotations

import sys
from pathlib import Path

SBATCH = r"""
import os, re, subprocess, sys
script = open(sys.argv[-1]).read()
array = re.search(r"--array='?0-(\d+)%", script)
tasks = [f"_{task}" for task in range(int(array[1]) + 1)] if array else [""]
if "REFUSED" in os.environ:
    sys.exit("sbatch: error: invalid partition specified: none")
jobs = os.path.join(HERE, "jobs")
os.makedirs(jobs, exist_ok=True)
job = str(len(os.listdir(jobs)) + 1)
os.makedirs(os.path.join(jobs, job))
open(os.path.join(jobs, job, "script"), "w").write(script)
for task in tasks:
    state = os.path.join(jobs, job, job + task)
    open(state, "w").write("RUNNING")
    env = os.environ | {
        "SLURM_JOB_ID": job, "SLURM_NTASKS": "1", "SLURM_JOB_NUM_NODES": "1", "SLURM_NODEID": "0",
        "SLURM_JOB_NODELIST": "here", "SLURM_PROCID": "0", "SLURM_LOCALID": "0",
    }
    if array:
        env |= {"SLURM_ARRAY_JOB_ID": job, "SLURM_ARRAY_TASK_ID": task[1:]}
    ends = f'bash {jobs}/{job}/script && echo COMPLETED > {state} || echo NODE_FAIL > {state}'
    null = subprocess.DEVNULL
    subprocess.Popen(["bash", "-c", ends], env=env, stdin=null, stdout=null, stderr=null, start_new_session=True)
print("Submitted batch job", job)
"""
SRUN = """
import os, sys
words = sys.argv[1:]
while words[0].startswith("--"):
    words = words[1 if words[0] == "--unbuffered" else 2:]
os.execv(words[0], words)
"""
SACCT = """
import os
print("JobID|State|NodeList")
jobs = os.path.join(HERE, "jobs")
for job in os.listdir(jobs):
    for task in os.listdir(os.path.join(jobs, job)):
        if task != "script":
            print(f"{task}|{open(os.path.join(jobs, job, task)).read().strip()}|here")
"""
COMMANDS = {"sbatch": SBATCH, "srun": SRUN, "sacct": SACCT, "scancel": ""}


def write_slurm(folder: Path) -> Path:
    """Write the commands into a new folder, which belongs into ``PATH``."""
    folder.mkdir()
    for name, code in COMMANDS.items():
        (folder / name).write_text(f"#!{sys.executable}\nHERE = {str(folder)!r}\n{code}")
        (folder / name).chmod(0o755)
    return folder
