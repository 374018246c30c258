#include "server/net/access.h"

#include <arpa/inet.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { IPV4_BITS = 32, IPV6_BITS = 128, TEXT_BYTES = 64 };

static struct in6_addr mapped(struct in_addr ipv4) {
  struct in6_addr address = {.s6_addr = {[10] = 0xff, [11] = 0xff}};
  memcpy(&address.s6_addr[12], &ipv4, sizeof ipv4);
  return address;
}

/* Reads a number of bits from 0 to `most`. Returns false if the text is anything else. */
static bool read_bits(const char *text, unsigned most, unsigned *bits) {
  char *end;
  const unsigned long number = strtoul(text, &end, 10);
  *bits = (unsigned)number;
  return *text >= '0' && *text <= '9' && *end == '\0' && number <= most;
}

static bool read_network(const char *text, struct access_network *network) {
  char address[TEXT_BYTES];
  const char *slash = strchr(text, '/');
  const size_t length = slash != NULL ? (size_t)(slash - text) : strlen(text);
  if (length >= sizeof address) {
    return false;
  }
  memcpy(address, text, length);
  address[length] = '\0';
  struct in_addr ipv4;
  unsigned most = IPV6_BITS;
  if (inet_pton(AF_INET, address, &ipv4) == 1) {
    network->address = mapped(ipv4);
    most = IPV4_BITS;
  } else if (inet_pton(AF_INET6, address, &network->address) != 1) {
    return false;
  }
  unsigned bits = most;
  if (slash != NULL && !read_bits(slash + 1, most, &bits)) {
    return false;
  }
  network->bits = IPV6_BITS - most + bits;
  return true;
}

const struct options_list access_this_machine = {.items = {"127.0.0.0/8", "::1/128"}, .count = 2};
const struct options_list access_anyone = {.items = {"0.0.0.0/0", "::/0"}, .count = 2};

bool access_read(const struct options_list *list, const struct options_list *usual,
                 struct access *access, const char **wrong) {
  const struct options_list *from = list->count > 0 ? list : usual;
  access->count = 0;
  for (size_t i = 0; i < from->count; i++) {
    *wrong = from->items[i];
    if (!read_network(from->items[i], &access->networks[access->count++])) {
      return false;
    }
  }
  return true;
}

bool access_read_option(const char *name, const struct options_list *list,
                        const struct options_list *usual, struct access *access) {
  const char *wrong = "";
  if (access_read(list, usual, access, &wrong)) {
    return true;
  }
  fprintf(stderr, "dipoled: --%s takes numeric addresses, as 192.0.2.7 or 192.0.2.0/24, not '%s'\n",
          name, wrong);
  return false;
}

/* The first 96 bits of a network of IPv4 are those of ::ffff:0:0. So ::/0 is all of IPv6 and contains
 * no address of IPv4. */
static bool is_in(const struct in6_addr *address, const struct access_network *network) {
  const bool ipv4 =
      IN6_IS_ADDR_V4MAPPED(&network->address) && network->bits >= IPV6_BITS - IPV4_BITS;
  bool same = ipv4 == !!IN6_IS_ADDR_V4MAPPED(address);
  for (unsigned bit = 0; same && bit < network->bits; bit++) {
    const unsigned differs = address->s6_addr[bit / 8] ^ network->address.s6_addr[bit / 8];
    same = (differs & (0x80U >> bit % 8)) == 0;
  }
  return same;
}

bool access_allows(const struct access *access, const struct sockaddr *address) {
  struct in6_addr ip;
  if (address->sa_family == AF_INET) {
    ip = mapped(((const struct sockaddr_in *)(const void *)address)->sin_addr);
  } else if (address->sa_family == AF_INET6) {
    ip = ((const struct sockaddr_in6 *)(const void *)address)->sin6_addr;
  } else {
    return false;
  }
  for (size_t i = 0; i < access->count; i++) {
    if (is_in(&ip, &access->networks[i])) {
      return true;
    }
  }
  return false;
}

bool access_allows_peer(const struct access *access, int fd) {
  struct sockaddr_storage peer = {0};
  socklen_t length = sizeof peer;
  return getpeername(fd, (struct sockaddr *)&peer, &length) == 0 &&
         (peer.ss_family == AF_UNIX || access_allows(access, (const struct sockaddr *)&peer));
}
