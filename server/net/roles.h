/* roles: what clients with certificates may request. A file gives roles to them, one line each:
 *
 *   # roles             who
 *   evaluate,compute    subject:CN=node7,O=farm   whose certificate has this subject (RFC 2253)
 *   evaluate,read       role:Operator             whose certificate has this role
 *   read,write:100-219  role:Instrument
 *   observe,fc3:1200    *                         everybody
 *
 * The role of a certificate is a UTF8String in the extension 1.3.6.1.4.1.50316.802.1, as
 * MODBUS/TCP Security defines it. A client has the roles of all lines that name it.
 *
 * Modbus masters have rights in place of roles: read, write or fcN, which is the function of that
 * number, each for all addresses, for one, or from one to another.
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
  ROLE_ALL = 7, /* roles of a client if no file limits them */
};

/* A right of Modbus masters, for the addresses of registers or bits from first to last. */
struct roles_right {
  bool reads, writes; /* whether any reading, or any writing, function is allowed */
  unsigned function;  /* the only function that is allowed; 0: see above */
  unsigned first, last;
};

/* The rights of one Modbus master. */
struct roles_rights {
  size_t count;
  struct roles_right items[];
};

struct roles;

/* Reads a file. If that fails, writes the reason, with the number of the line, and returns NULL. */
struct roles *roles_read(const char *path, char *why, size_t why_bytes);
void roles_free(struct roles *roles); /* may be NULL */

/* Returns the sum of a client's roles. subject, role: of its certificate, "" if it has none. */
unsigned roles_of(const struct roles *roles, const char *subject, const char *role);

/* Returns a copy of a Modbus master's rights, which the caller frees; NULL if there is no memory. */
struct roles_rights *roles_rights_of(const struct roles *roles, const char *subject,
                                     const char *role);

/* Returns whether a master may use a function to read, or write, `count` registers or bits from
 * `first` on. Rights must hold each of them. Count 0: the function names none, and any right to
 * read, or any right to this function, is enough. */
bool roles_allow(const struct roles_rights *rights, unsigned function, bool writes, unsigned first,
                 unsigned count);

const char *roles_name(unsigned role); /* name of a single role: evaluate, compute or observe */

#endif
