#!/bin/sh
# Record the sample logs again: sh sample_logs/record.sh .venv/bin/tunenet-record
set -eu
record=$1
here=$(dirname "$0")
$record --simulate drop --restitution 0.85 --height 1.5 --rate 120 --seed 1 -o "$here/bouncy.mcap" --overwrite
$record --simulate drop --restitution 0.35 --height 0.8 --rate 60 --seed 2 -o "$here/dull.mcap" --overwrite
$record --simulate drop --restitution 0.62 --height 1.0 --rate 240 --hold 0.8 --noise 0.001 --seed 3 -o "$here/noisy.mcap" --overwrite
$record --simulate drop --restitution 0.8 --slope 0.06 --drag 0.11 --height 1.2 --rate 120 --noise 0.001 --seed 4 -o "$here/light.mcap" --overwrite
$record --simulate payload --mass 0.8 --driver --seconds 6 --seed 3 -o "$here/payload.mcap" --overwrite
$record --simulate payload --empty --driver --seconds 6 --seed 3 -o "$here/payload_empty.mcap" --overwrite
$record --simulate drop --render --restitution 0.74 --height 1.1 --seconds 2.6 --hold 0.4 --blur 4 --seed 6 -o "$here/filmed.mcap" --overwrite
