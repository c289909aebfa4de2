#!/usr/bin/env bash
# Repeat the experiment of docs/training.md, from the top of the repository:
#   examples/learned_agent/repeat.sh data PROCTHOR | train | score PROCTHOR
# PROCTHOR is the folder of ProcTHOR's houses. PYTHON is the interpreter that has torch, OUT the folder for all files.
set -euo pipefail
here=examples/learned_agent
PYTHON=${PYTHON:-python}
OUT=${OUT:-out/learned}
SEEDS=${SEEDS:-0 1 2}
export OMP_NUM_THREADS=1
case $1 in
data)
  condvln demo --family procthor --scenes 48 --seed 11 --out "$OUT/houses" --workers 1
  for name in made made_test; do condvln generate $here/$name.yaml --inline; done
  for name in real real_test; do condvln generate $here/$name.yaml --data procthor="$2" --inline; done
  for kind in direct looking; do
    for part in "train 1100 $kind" "val_unseen 50 $kind-held"; do
      read -r split most file <<<"$part"
      $PYTHON $here/record.py --kind $kind --split "$split" --most "$most" --out "$OUT/walks/$file.pt" \
        "$OUT/made/export=$OUT/houses" "$OUT/real/export=$2"
    done
  done ;;
train)
  for seed in $SEEDS; do
    for kind in direct looking; do
      $PYTHON $here/train.py "$OUT/walks/$kind.pt" --held-out "$OUT/walks/$kind-held.pt" --seed "$seed" \
        --out "$OUT/nets/$kind-$seed"
    done
  done ;;
score)
  for test in made real; do
    export=$OUT/${test}_test/export data=$([ $test = made ] && echo "$OUT/houses" || echo "$2")
    files=()
    for agent in always-then always-else random-leaf nearest; do
      condvln walk "$export" test --agent $agent --data procthor="$data" --out "$OUT/scores/$test/$agent.json"
      files+=("$OUT/scores/$test/$agent.json")
    done
    for net in "$OUT"/nets/*/; do
      net=$(basename "$net") file=$OUT/scores/$test/$(basename "$net").json
      LEARNED_AGENT=$OUT/nets/$net/checkpoint.pt LEARNED_AGENT_EYES=$export=$data $PYTHON -c "from jobs.command import main; main()" walk \
        "$export" test --agent examples.learned_agent.agent:Agent --data procthor="$data" --out "$file"
      files+=("$file")
    done
    condvln evaluate "$export" test "${files[@]}" --data procthor="$data" --all --scores "$OUT/scores/$test.jsonl"
  done ;;
esac
