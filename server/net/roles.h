/* roles: what clients with certificates may request. A file gives roles to them, one line each:
 *
 *   # roles           who
 *   evaluate,compute  subject:CN=node7,O=farm   whose certificate has this subject (RFC 2253)
 *   read,write        role:Instrument           whose certificate has this role
 *   observe           *                         everybody
 *
 * The role of a certificate is a UTF8String in the extension 1.3.6.1.4.1.50316.802.1, as
 * MODBUS/TCP Security defines it. A client has the roles of all lines that name it.
 */
#ifndef DIPOLED_ROLES_H
#define DIPOLED_ROLES_H

#include <stdbool.h>
#include <stddef.h>

enum role {
  ROLE_ANYBODY = 0, /* for messages that need no role */
  ROLE_EVALUATE = 1,
  ROLE_COMPUTE = 2, /* for messages that may take seconds */
  ROLE_OBSERVE = 4,
  ROLE_READ = 8, /* for functions of Modbus */
  ROLE_WRITE = 16,
  ROLE_ALL = 31, /* roles of a client if no file limits them */
};

struct roles;

/* Reads a file. If that fails, writes the reason, with the number of the line, and returns NULL. */
struct roles *roles_read(const char *path, char *why, size_t why_bytes);
void roles_free(struct roles *roles); /* may be NULL */

/* Returns the sum of a client's roles. subject, role: of its certificate, "" if it has none. */
unsigned roles_of(const struct roles *roles, const char *subject, const char *role);

const char *roles_name(unsigned role); /* name of a single role, as evaluate */

#endif
