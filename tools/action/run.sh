#!/usr/bin/env bash
# Runs scenarios, holds their bounds and appends their reports to the page of the job: the step of action.yml, or of any other CI.
#
#   run.sh OUT SCENARIO...
#
# LOCSIM is the program (locsim), LOCSIM_OPTIONS are further options of `locsim run`, separated by blanks. The page is the file
# GITHUB_STEP_SUMMARY, standard output without it. The exit code is the largest of the runs: 1 where a bound is missed, 2 for
# bad input.
set -uo pipefail

if [ "$#" -lt 2 ]; then
    echo "usage: run.sh OUT SCENARIO..." >&2
    exit 2
fi
out=$1
shift
page=${GITHUB_STEP_SUMMARY:-/dev/stdout}
read -r -a options <<<"${LOCSIM_OPTIONS:-}"

worst=0
for scenario in "$@"; do
    name=$(basename "$scenario")
    results=$out/${name%.y*ml}
    messages=$(mktemp)
    "${LOCSIM:-locsim}" run "$scenario" --out "$results" "${options[@]}" 2> >(tee "$messages" >&2)
    code=$?
    # The page has no room for figures: those are in the results.
    if [ -f "$results/report.md" ] && [ "$code" -le 1 ]; then
        grep -v '^!\[' "$results/report.md" | sed '/^## One trial in pictures/,$d' >>"$page"
    else
        printf '# %s\n\n`locsim run` ended with exit code %s.\n\n' "$scenario" "$code" >>"$page"
    fi
    if [ "$code" -ne 0 ]; then
        printf '```text\n%s\n```\n\n' "$(tail -c 4000 "$messages")" >>"$page"
    fi
    rm -f "$messages"
    if [ "$code" -gt "$worst" ]; then worst=$code; fi
done
exit "$worst"
