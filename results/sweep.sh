#!/usr/bin/env bash
# Train one line of a list of runs, by its number from 0. A line is the name of a run, and flags of
# train.py. The run goes to runs/NAME, and what it says to runs/NAME.log. All lines of a list of ten:
#
#     sbatch --array=0-9 results/sweep.sh LIST               on a cluster with SLURM
#     seq 0 9 | xargs -P 2 -n 1 results/sweep.sh LIST        on one machine, two runs at a time
#
# A run that was killed goes on from its last checkpoint if it is started again, and one that is
# finished ends after some seconds. A run has as many threads as SLURM gives it cores, or as CORES says.
# After a run that a signal has ended at once, xargs starts no other one: start all of them again.
#SBATCH --cpus-per-task=1
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --output=slurm-%A.log
set -u
list=$(realpath "$1")
number=${2:-${SLURM_ARRAY_TASK_ID:?"a number is missing: results/sweep.sh LIST NUMBER"}}
# sbatch runs a copy of this file from elsewhere
if [ $# -gt 1 ]; then cd "$(dirname "$0")/.."; else cd "$SLURM_SUBMIT_DIR"; fi || exit 1
read -r name flags < <(sed -n "$((number + 1))p" "$list")
test -n "${name:-}" || { echo "$list has no line $number, counted from 0" >&2; exit 1; }
python=$(ls .venv/bin/python 2> /dev/null || command -v python)
export PJRT_NPROC=${SLURM_CPUS_PER_TASK:-${CORES:-1}}  # JAX's threads; --threads are MuJoCo's
folder=runs/$name
mkdir -p "$folder"
if [ -e "$folder/checkpoint.npz" ]; then
    flags="$flags --resume"
elif { [ -e "$folder/metrics.csv" ] || [ ! -e "$folder/policy.npz" ]; } &&
    [ "$(cat "$folder/metrics.csv" 2> /dev/null | wc -l)" -lt 3 ]; then
    # a run that was killed in its first save, which ends with the policies and the checkpoint,
    # starts anew, unless somebody trains there
    flock -n "$folder/lock" rm -f "$folder"/{config.json,metrics.csv,policy.npz,policy_prime.npz}
fi
# train.py takes the place of this script, so that a signal to either arrives once, and it saves: a
# second one would end it at once
# shellcheck disable=SC2086  # flags are several words
exec "$python" train.py $flags --threads "$PJRT_NPROC" --out "$folder" >> "$folder.log" 2>&1
