#!/usr/bin/env bash
# Repeat the experiment of docs/training.md, from the top of the repository:
#   examples/learned_agent/repeat.sh data PROCTHOR | train | score PROCTHOR
# PROCTHOR is the folder of ProcTHOR's houses; PYTHON is the interpreter that has torch.
set -euo pipefail
here=examples/learned_agent out=out/learned
PYTHON=${PYTHON:-python}
export OMP_NUM_THREADS=1

tested() { # NAME HOUSES DATASET: other episodes in the houses of a configuration's test split, half of them O0 and O2
  condvln generate "$here/$1.yaml" --inline --data procthor="$3" --set name="learned-$1-test" \
    --set store="$PWD/$out/$1_test/store" --set export="$PWD/$out/$1_test/export" --set splits.bias=warn \
    --set sources.0.scenes="[$2]" --set splits.scenes='{test: ["procthor/*"]}' \
    --set instructions.per_category='{nested: 3, chain: 3}' --set instructions.counterfactual_groups=2 \
    --set instructions.cells='[{category: simple, observability: O0, count: 8}, {category: simple,
      observability: O1, count: 7}, {category: simple, observability: O2, count: 7}]'
}

case $1 in
data)
  condvln demo --family procthor --scenes 48 --seed 11 --out $out/houses --workers 1
  condvln generate $here/made.yaml --inline
  condvln generate $here/real.yaml --inline --data procthor="$2"
  tested made '"houses-4?"' $out/houses
  tested real '"houses60-4[1-49]", houses60-50, houses60-54, houses60-57' "$2"
  for kind in direct looking; do
    for part in "train 1100 $kind" "val_unseen 50 $kind-held"; do
      read -r split most file <<<"$part"
      $PYTHON $here/record.py --kind $kind --split "$split" --most "$most" --out "$out/walks/$file.pt" \
        $out/made/export=$out/houses $out/real/export="$2"
    done
  done ;;
train)
  for seed in 0 1 2; do
    for kind in direct looking; do
      $PYTHON $here/train.py $out/walks/$kind.pt --held-out $out/walks/$kind-held.pt --seed $seed --out $out/nets/$kind-$seed
    done
  done ;;
score)
  for test in made real; do
    mkdir -p $out/scores/$test
    export=$out/${test}_test/export data=$([ $test = made ] && echo $out/houses || echo "$2") files=()
    walk() { # NAME COMMAND…: the predictions of an agent
      files+=("$out/scores/$test/$1.json")
      "${@:2}" "$export" test --data procthor="$data" --out "$out/scores/$test/$1.json"
    }
    for agent in always-then always-else random-leaf nearest; do walk $agent condvln walk --agent $agent; done
    for net in $out/nets/*/; do
      export LEARNED_AGENT=${net}checkpoint.pt LEARNED_AGENT_EYES=$export=$data
      walk "$(basename "$net")" $PYTHON -c "from jobs.command import main; main()" walk \
        --agent examples.learned_agent.agent:Agent
    done
    condvln evaluate "$export" test "${files[@]}" --data procthor="$data" --all --scores $out/scores/$test.jsonl
  done ;;
esac
