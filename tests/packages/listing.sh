# list_files: every file of the system, but for what apt, dpkg and ld.so keep, and this test.
list_files() {
  find / -xdev \( -path /proc -o -path /opt -o -path /tmp -o -path /var/cache -o -path /var/log \
    -o -path /var/lib/apt -o -path /var/lib/dpkg \) -prune -o -print | LC_ALL=C sort
}
