#!/bin/sh
# An actuator: appends each answer to the file that is its argument.
#
#     actuator = { kind = "exec", command = ["docs/examples/external/record.sh", "answers.txt"] }

while read -r word bytes media shape source; do # answer BYTES MEDIA-TYPE SHAPE SOURCE, then as many bytes
    answer=$(head -c "$bytes")
    if printf '%s %s\n' "$source" "$answer" >> "$1"; then
        echo done
    else
        echo "error cannot write to $1"
    fi
done
