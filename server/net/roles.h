/* roles: what clients with certificates may ask for. A file gives roles to them, one line each:
 *
 *   # roles            who
 *   evaluate,compute   subject:CN=node7,O=farm   whose certificate has this subject (RFC 2253)
 *   evaluate           role:Operator             whose certificate has this role
 *   observe            *                         everybody
 *
 * The role of a certificate is a UTF8String in the extension 1.3.6.1.4.1.50316.802.1, as
 * MODBUS/TCP Security defines it. A client has the roles of all lines that name it.
 */
#ifndef DIPOLED_ROLES_H
#define DIPOLED_ROLES_H

#include <stddef.h>

enum role {
  ROLE_EVALUATE = 1, /* eval, offers, sample, invert and varying */
  ROLE_COMPUTE = 2,  /* mc, table and fit: what may take seconds */
  ROLE_OBSERVE = 4,  /* statistics */
  ROLE_ALL = 7,      /* what a client has where no file gives roles */
};

struct roles;

/* Reads a file. If that fails, writes the reason, with the number of the line, and returns NULL. */
struct roles *roles_read(const char *path, char *why, size_t why_bytes);
void roles_free(struct roles *roles); /* may be NULL */

/* Returns the sum of a client's roles. subject, role: of its certificate, "" if it has none. */
unsigned roles_of(const struct roles *roles, const char *subject, const char *role);

/* Returns the role that a message of this type needs; 0 if everybody may send it, as hello, media,
 * ping and cancel, or if there is no such message. */
unsigned roles_needed(unsigned type);

const char *roles_name(unsigned role); /* of one role: evaluate, compute or observe */

#endif
