# Read by the other tools: the checkout's root, its virtual environment, and how they speak.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
readonly venv=.venv
readonly build=build/release
jobs=${SOOPNAV_JOBS:-$(nproc)}
readonly jobs

say() { printf '\033[1m== %s\033[0m\n' "$*"; }
[ -t 1 ] || say() { printf '== %s\n' "$*"; }
die() {
  printf '%s: %s\n' "$(basename "$0")" "$*" >&2
  exit 1
}

# require_venv: the tools that need the set-up call this instead of running it.
require_venv() { [ -x "$venv/bin/soopnav" ] || die "no $venv/bin/soopnav in this checkout; run tools/setup first"; }
