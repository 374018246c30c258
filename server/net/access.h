/* access: the addresses from which clients may connect over TCP. */
#ifndef DIPOLED_ACCESS_H
#define DIPOLED_ACCESS_H

#include <netinet/in.h>
#include <stdbool.h>
#include <sys/socket.h>

#include "server/options.h"

/* A network: all addresses that begin with the same bits. An IPv4 address is ::ffff:a.b.c.d. */
struct access_network {
  struct in6_addr address;
  unsigned bits;
};

struct access {
  struct access_network networks[OPTIONS_LIST_MAX];
  size_t count;
};

/* The networks that replace an option that is not given. */
extern const struct options_list access_this_machine; /* 127.0.0.0/8 and ::1/128 */
extern const struct options_list access_anyone;       /* all of IPv4 and IPv6 */

/* Reads a list of networks, each as ADDRESS/BITS or ADDRESS; `usual` replaces an empty list.
 * Returns false if an item cannot be read, and sets *wrong to it. */
bool access_read(const struct options_list *list, const struct options_list *usual,
                 struct access *access, const char **wrong);

/* The same for the option --NAME: if an item cannot be read, prints a message to standard error and
 * returns false. */
bool access_read_option(const char *name, const struct options_list *list,
                        const struct options_list *usual, struct access *access);

/* Returns whether an address of IPv4 or IPv6 is in one of the networks. */
bool access_allows(const struct access *access, const struct sockaddr *address);

/* Returns whether the peer of a connected socket is in one of the networks, or uses a Unix socket,
 * whose file says who may. */
bool access_allows_peer(const struct access *access, int fd);

#endif
