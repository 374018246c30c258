/* access: the addresses from which Modbus masters may connect. */
#ifndef DIPOLED_MODBUS_ACCESS_H
#define DIPOLED_MODBUS_ACCESS_H

#include <netinet/in.h>
#include <stdbool.h>
#include <sys/socket.h>

#include "server/options.h"

/* A network: all addresses that begin with the same bits. An IPv4 address is ::ffff:a.b.c.d. */
struct modbus_network {
  struct in6_addr address;
  unsigned bits;
};

struct modbus_access {
  struct modbus_network networks[OPTIONS_LIST_MAX];
  size_t count;
};

/* Reads a list of networks, each as ADDRESS/BITS or ADDRESS. An empty list allows only this
 * machine. Returns false if an item cannot be read, and sets *wrong to it. */
bool modbus_access_read(const struct options_list *list, struct modbus_access *access,
                        const char **wrong);

/* Returns whether an address of IPv4 or IPv6 is in one of the networks. */
bool modbus_access_allows(const struct modbus_access *access, const struct sockaddr *address);

#endif
