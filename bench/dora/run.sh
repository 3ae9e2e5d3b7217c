#!/bin/sh
# One node of the dora chain: run.sh ROLE FILE; the sink's lines go to FILE.
exec python "$(dirname "$0")/node.py" "$1" >> "$2"
