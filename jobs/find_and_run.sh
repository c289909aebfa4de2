library='/lib[^/]*/python[^/]*/[a-z]*-packages/ray/_raylet[.]so'
environment=$(sed -n "s#^[^/]*\(/.*\)$library\$#\1#p" "/proc/$PPID/maps" 2>/dev/null | head -n 1)
if [ -n "$environment" ] && [ -x "$environment/bin/condvln" ]; then
  exec "$environment/bin/condvln" "$@"
fi
if command -v condvln >/dev/null 2>&1; then
  exec condvln "$@"
fi
echo "condvln: not found on the head node, neither in Ray's environment (${environment:-unknown})" \
  "nor on PATH ($PATH). Install condvln into the environment that runs Ray, on every node." >&2
exit 127
