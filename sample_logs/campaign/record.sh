#!/bin/sh
# Record the sample campaign again: sh sample_logs/campaign/record.sh .venv/bin/tunenet-record
set -eu
record=$1
here=$(dirname "$0")
drop() {
    name=$1
    shift
    $record --simulate drop "$@" -o "$here/$name.mcap" --overwrite
}
rm -f "$here"/outcome_*.mcap
outcome() {
    log=$1
    shift
    $record --outcome "$@" --drop-log "$here/$log.mcap" -o "$here"
}

drop drop_1 --render --size 240x180 --restitution 0.789 --height 0.8 --seconds 2 --hold 0.2 --seed 24
outcome drop_1 success --ball "red gel" --shot-height 0.274 --miss 0.006 --at 2026-11-02T10:00Z
drop drop_2 --restitution 0.741 --height 0.8 --seconds 2.5 --noise 0.001 --seed 12
outcome drop_2 failure --ball racquetball --shot-height 0.305 --miss -0.041 --reason rim --at 2026-11-02T10:03Z
drop drop_3a --restitution 0.79 --height 0.8 --seconds 0.35 --noise 0.001 --seed 13
drop drop_3b --restitution 0.793 --height 0.8 --seconds 2.5 --noise 0.001 --seed 14
outcome drop_3b success --ball "red gel" --shot-height 0.274 --miss -0.011 --note "first drop hit the edge" --at 2026-11-02T10:08Z
drop drop_4 --restitution 0.738 --height 0.8 --seconds 2.5 --noise 0.001 --seed 15
outcome drop_4 success --ball racquetball --shot-height 0.305 --miss 0.009 --at 2026-11-02T10:12Z
drop drop_5 --restitution 0.786 --height 0.8 --seconds 2.5 --noise 0.001 --seed 16
outcome drop_5 success --ball "red gel" --shot-height 0.280 --miss 0.013 --at 2026-11-02T10:15Z
drop drop_6 --restitution 0.74 --height 0.8 --seconds 0.3 --noise 0.001 --seed 17
outcome drop_6 failure --ball racquetball --reason "no good drop" --at 2026-11-02T10:20Z
