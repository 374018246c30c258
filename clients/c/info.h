/* info: asks a daemon for its description of itself. */
#ifndef LIBDIPOLE_INFO_H
#define LIBDIPOLE_INFO_H

#include "clients/c/request.h"

/* Sends hello and makes client->info of the reply and a copy of the connection's address. */
bool libdipole_hello(dipole_client *client, const char *address, dipole_error *error);

#endif
