# In the new system, booted: the daemon that systemd has started.
socket=unix:/run/dipoled.sock

systemctl is-active dipoled.socket dipoled.service
dipole info --connect "$socket" >/dev/null
dipole eval --connect "$socket" --medium skin1 --count 3 --format csv | cmp - /opt/private.csv
# The members of the group may ask, and nobody else.
member=$(getent group dipole | cut -d: -f3)
setpriv --reuid=65534 --regid=65534 --groups="$member" dipole media --connect "$socket" >/dev/null
! setpriv --reuid=65534 --regid=65534 --clear-groups \
  dipole media --connect "$socket" --retry-ms 0 >/dev/null 2>&1
# Everything that it does is allowed by its filter of system calls: a table, Monte Carlo, metrics.
dipole table --connect "$socket" --medium skin1 --model transport --output - >/dev/null
dipole mc --connect "$socket" --medium skin1 --channel red --photons 20000 --rings 2 >/dev/null
echo DIPOLED_METRICS=127.0.0.1:9817 >/etc/default/dipoled
systemctl restart dipoled.service || journalctl --no-pager -u dipoled.service
python3 -c '
from urllib.request import urlopen
assert b"dipoled_" in urlopen("http://127.0.0.1:9817/metrics", timeout=10).read()'
# And the filter is there, and nothing else is allowed.
process=$(systemctl show -p MainPID --value dipoled.service)
grep -q '^Seccomp:.2$' "/proc/$process/status"
grep -q '^NoNewPrivs:.1$' "/proc/$process/status"
grep -q '^CapEff:.0000000000000000$' "/proc/$process/status"
[ "$(stat -c %u "/proc/$process")" != 0 ]
# Two more of them, beside the first.
echo DIPOLED_METRICS=127.0.0.1:9821 >/etc/default/dipoled-1
systemctl enable --now dipoled@1 dipoled@2 || journalctl --no-pager -u 'dipoled@*'
for one in 1 2; do
  own=unix:/run/dipoled-$one/dipoled.sock
  setpriv --reuid=65534 --regid=65534 --groups="$member" \
    dipole eval --connect "$own" --medium skin1 --count 3 --format csv | cmp - /opt/private.csv
  ! setpriv --reuid=65534 --regid=65534 --clear-groups \
    dipole media --connect "$own" --retry-ms 0 >/dev/null 2>&1
  grep -q '^Seccomp:.2$' "/proc/$(systemctl show -p MainPID --value dipoled@$one)/status"
done
python3 -c '
from urllib.request import urlopen
assert urlopen("http://127.0.0.1:9821/readyz", timeout=10).status == 200'
systemctl disable --now dipoled@1 dipoled@2
[ ! -e /run/dipoled-1 ]
# Stopped, it comes back for the next who asks.
systemctl stop dipoled.service
[ "$(systemctl is-active dipoled.service)" = inactive ]
dipole eval --connect "$socket" --medium skin1 --count 3 --format csv | cmp - /opt/private.csv
systemctl is-active dipoled.service
[ "$(systemctl show -p NRestarts --value dipoled.service)" = 0 ]
journalctl --no-pager -u dipoled.service -u dipoled.socket -u 'dipoled@*' >/opt/journal
grep -q event=ready /opt/journal
[ -z "$(grep -E 'level=error|[Ff]ailed' /opt/journal)" ]
