#!/bin/sh
# An actuator: appends each answer, all its parts in a line, to the file that is its argument.
#
#     actuator = { kind = "exec", command = ["docs/examples/external/record.sh", "answers.txt"] }

answer=
while read -r word bytes media shape source; do # part|answer BYTES MEDIA-TYPE SHAPE SOURCE, then as many bytes
    answer="$answer $(head -c "$bytes")"
    if [ "$word" = part ]; then # the line "answer" has the last part; only this line gets a reply
        continue
    fi
    if printf '%s%s\n' "$source" "$answer" >> "$1"; then
        echo done
    else
        echo "error cannot write to $1"
    fi
    answer=
done
