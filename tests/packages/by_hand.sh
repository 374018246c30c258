# In the new system: the daemon as its unit starts it, at its unit's socket, without systemd.
program=$(sed -n 's/^ExecStart=//p' /lib/systemd/system/dipoled.service)
path=$(sed -n 's/^ListenStream=\(\/.*\)/\1/p' /lib/systemd/system/dipoled.socket)
mkfifo /opt/daemon.log
env -i DIPOLED_LISTEN="unix:$path" "$program" 2>/opt/daemon.log &
daemon=$!
{
  while read -r line; do
    case $line in *event=ready*) break ;; esac
  done
  dipole eval --connect "unix:$path" --medium skin1 --count 3 --format csv >/opt/asked.csv
  kill "$daemon"
  wait "$daemon"
} </opt/daemon.log
cmp /opt/asked.csv /opt/private.csv
