#!/bin/sh
# Install what a lock of this Python and this machine has, each package with its hash: install.sh cpu|cuda
set -e
where=$(python -c 'import platform, sys; print("%d.%d" % sys.version_info[:2], sys.platform, platform.machine(), sep="-")')
lock="$(dirname "$0")/$1-$where.txt"
if [ ! -f "$lock" ]; then echo "no $lock: no hashes"; exit 0; fi
exec pip install --no-cache-dir --require-hashes --no-deps -r "$lock"
