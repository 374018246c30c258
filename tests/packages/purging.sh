# In the new system: nothing is left of the packages, nor of what they had brought along.
export DEBIAN_FRONTEND=noninteractive

names=$(for deb in /opt/packages/*.deb; do dpkg-deb -f "$deb" Package; done)
apt-get -y purge $names
apt-get -y --purge autoremove
. /opt/listing.sh
list_files >/opt/after
diff /opt/before /opt/after
# Neither among what apt and dpkg keep themselves.
left=$(find / -xdev \( -path /opt -o -path /proc -o -path /var/log \) -prune \
  -o -name '*dipole*' -print)
[ -z "$left" ] || {
  echo "left: $left"
  exit 1
}
