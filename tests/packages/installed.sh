# In the new system, where no systemd runs: the programs, the module and the pages do their work.
dipole --version
dipole eval --medium skin1 --count 3 --format csv >/opt/private.csv
[ "$(wc -l </opt/private.csv)" -gt 3 ]

cat >/opt/ask.py <<'PYTHON'
import dipole

with dipole.Client() as client:
    answer = client.eval("better", dipole.Medium(0.0, 1.0), [1.0])
    assert answer.albedo[0] == 1.0
print(dipole.__file__)
PYTHON
[ "$(python3 /opt/ask.py)" = /usr/lib/python3/dist-packages/dipole/__init__.py ]

for page in /usr/share/man/man*/*dipole*; do
  gzip -dc "$page" | grep -q '^\.TH '
done
for script in /usr/share/bash-completion/completions/dipole*; do
  bash -n "$script"
done
ldconfig -p | grep -q 'libdipole\.so\.0 '
systemctl is-enabled dipoled.socket dipoled.service
