#!/bin/sh
# A sensor: grey pictures of 64 × 48 pixels, in turn dark and bright, with their right answers.
#
#     sensor = { kind = "exec", command = ["docs/examples/external/light.sh"] }
#
# A real sensor would read a device. This sensor makes the picture up.

number=0
while read -r request; do # one line, "next", for each sample
    number=$((number + 1))
    if [ $((number % 2)) -eq 0 ]; then
        label=bright pixel='\310'
    else
        label=dark pixel='\020'
    fi
    echo "sequence $number"
    echo "label $label"
    echo "source picture-$number"
    echo "answer 3072 image/x-grey8 48x64x1:u8"
    head -c 3072 /dev/zero | tr '\0' "$pixel"
done
