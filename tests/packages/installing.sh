# In the new system: installs the packages as somebody does who has them as files.
export DEBIAN_FRONTEND=noninteractive

apt-get update
# What there is before, but for what apt and dpkg keep themselves.
. /opt/listing.sh
list_files >/opt/before

dpkg -i /opt/packages/*.deb || true # not yet: what they depend on is missing
apt-get -y --no-install-recommends -f install
for deb in /opt/packages/*.deb; do
  name=$(dpkg-deb -f "$deb" Package)
  [ "$(dpkg-query -W -f '${db:Status-Abbrev}' "$name")" = 'ii ' ]
  dpkg --verify "$name"
done
