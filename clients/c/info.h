/* info: what a daemon says about itself. */
#ifndef LIBDIPOLE_INFO_H
#define LIBDIPOLE_INFO_H

#include "clients/c/request.h"

/* Says hello and sets client->info, which gets a copy of the connection's address. */
bool libdipole_hello(dipole_client *client, const char *address, dipole_error *error);

#endif
