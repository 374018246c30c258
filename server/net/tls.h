/* tls: TLS 1.2 and 1.3 by OpenSSL: the daemon's certificate, and the sessions of connections.
 *
 * There is no renegotiation, no compression, no resumption and no early data; the ciphers have
 * forward secrecy and authenticate what they encrypt.
 */
#ifndef DIPOLED_TLS_H
#define DIPOLED_TLS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/types.h>

#include "server/net/roles.h"
#include "server/options.h"

/* The daemon's certificate and key, and the certificates that sign those of clients. */
struct tls;

/* One connection. Its socket must not block. */
struct tls_session;

/* Returns whether an option requests TLS. */
bool tls_is_wanted(const struct options *options);

/* Reads the files of --certificate, --key, --client-ca and --roles. If that fails, prints a message
 * to standard error and returns NULL. The caller calls tls_free(). */
struct tls *tls_new(const struct options *options);
void tls_free(struct tls *tls); /* may be NULL */

/* Reads the files again, for the sessions that begin from now on, and logs it. If that fails, logs
 * why and keeps what it has. */
void tls_reload(struct tls *tls);

/* Begins a session as a server. The caller keeps the socket, and calls tls_session_free(). Returns
 * NULL if there is no memory. */
struct tls_session *tls_session_new(struct tls *tls, int fd);

/* The functions above belong to the main thread, those that follow to any one thread at a time. */

void tls_session_free(struct tls_session *session); /* may be NULL */

enum tls_progress { TLS_DONE, TLS_WANTS_READ, TLS_WANTS_WRITE, TLS_FAILED };

/* Goes on with the handshake as far as it can without waiting. After TLS_FAILED, why has the
 * reason. */
enum { TLS_WHY_BYTES = 160 };
enum tls_progress tls_session_shake_hands(struct tls_session *session, char why[TLS_WHY_BYTES]);

/* Returns the sum of the client's roles (server/net/roles.h), after the handshake. */
unsigned tls_session_roles(const struct tls_session *session);

/* These return a number of bytes above 0, or UV_EAGAIN, or UV_EOF (reading) when the peer has ended
 * its sending side, or UV_EPROTO. A read also returns 0 when it has met a record without content,
 * as an update of keys, which takes tens of microseconds: the next read continues, and others ought
 * to be served before it. A write that has returned UV_EAGAIN is to be repeated with the same first
 * bytes, which may have moved. */
ssize_t tls_session_read(struct tls_session *session, void *to, size_t bytes);
ssize_t tls_session_write(struct tls_session *session, const void *from, size_t bytes);

/* Returns whether OpenSSL holds bytes that no read has returned. */
bool tls_session_holds(const struct tls_session *session);

/* Returns whether the last call waits until the socket can be written to; also a read does, which
 * has to reply to an update of keys first. */
bool tls_session_is_blocked(const struct tls_session *session);

/* Tells the peer that nothing more is sent. */
void tls_session_end(struct tls_session *session);

#endif
