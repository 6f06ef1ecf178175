#!/usr/bin/env bash
# On a machine with an accelerator: environment, tests, update and acting rates, two processes.
#
#     bash benchmarks/speed/accelerator.sh          writes results/bench/accelerator.json
#     DEVICE=cpu BIN=.venv/bin bash ...             tries the script itself on a processor, with an
#                                                   environment that is there; writes to build/bench/
#
# About five minutes beside what pip needs to download. Stops at the first part that fails.
set -euo pipefail
cd "$(dirname "$0")/../.."
DEVICE=${DEVICE:-cuda}
BIN=${BIN:-build/accelerator/bin}
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1

if [ ! -x "$BIN/python" ]; then
  "${PYTHON:-python3}" -m venv build/accelerator
  "$BIN/pip" install --quiet --disable-pip-version-check -c constraints.txt -e '.[test]'
fi
devices=$("$BIN/python" -c 'import torch; print(torch.cuda.device_count())')
if [ "$DEVICE" = cuda ] && [ "$devices" = 0 ]; then
  echo "error: no accelerator that torch can use; DEVICE=cpu tries the script without one" >&2
  exit 2
fi
if [ "$DEVICE" = cuda ]; then
  "$BIN/python" -m pytest -m gpu tests -p no:cacheprovider
fi
"$BIN/python" -W ignore benchmarks/speed/accelerator.py --device "$DEVICE"
if [ "$devices" -ge 2 ] || [ "$DEVICE" = cpu ]; then
  "$BIN/python" -W ignore benchmarks/speed/accelerator.py --device "$DEVICE" --processes 2
fi
"$BIN/python" benchmarks/speed/performance_page.py
