/* transport: the bytes of one connection on its socket, plain or by TLS, as a client of the worker. It
 * is the only place where the binary protocol, Modbus and SCPI are read from and written to a socket; it
 * counts bytes, and knows when a connection was active and how it ends. A plain socket is a stream of libuv,
 * which reads into the owner's memory and writes from it. With TLS, OpenSSL reads and writes the
 * socket itself, and libuv only says when it can.
 *
 * All functions belong to the worker's thread.
 */
#ifndef DIPOLED_TRANSPORT_H
#define DIPOLED_TRANSPORT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <uv.h>

#include "server/net/client.h"
#include "server/net/tls.h"
#include "server/server.h"

struct transport;

/* What the transport calls. The owner is the structure that has the transport as its first member. */
struct transport_calls {
  const char *name; /* what the names of events in the log begin with, as "modbus-" */
  /* Sets *room to memory for the next bytes and returns how many fit; 0 if there is none. */
  size_t (*room)(struct transport *transport, uint8_t **room);
  /* This many bytes have arrived in that memory. Or, if negative: UV_EOF, the peer has shut down
   * its sending side; UV_ENOBUFS, there was no room; reading then has ceased. 0: after
   * transport_drain(), nothing is unread. */
  void (*received)(struct transport *transport, ssize_t bytes);
  /* The write that transport_write() has begun has ended: this many more bytes are written. */
  void (*sent)(struct transport *transport, uint64_t bytes);
  void (*dropped)(
      struct transport *transport); /* the connection ends: nothing may use it any more */
  void (*closed)(struct transport *transport); /* called last: frees the owner */
};

struct transport {
  struct client client; /* first member: see client.h */
  struct server *server;
  union {
    uv_handle_t handle;
    uv_stream_t stream;
    uv_tcp_t tcp;
    uv_pipe_t pipe;
    uv_poll_t poll; /* with TLS */
  } uv;
  const struct transport_calls *calls;
  int fd;
  struct tls_session *tls; /* NULL: the bytes are plain */
  uint64_t writing_bytes;  /* number of bytes that libuv has still to write */
  bool writing;            /* whether the call of sent() is still to come */
  bool reading;
  bool lingering; /* see transport_linger() */
  bool has_more;  /* with TLS: whether OpenSSL may hold bytes for which there was no time or room */
  bool tells_empty;    /* TLS only: see transport_drain() */
  bool blocked;        /* with TLS: whether reading waits until the socket can be written to */
  int events;          /* TLS only: events for which the poll waits */
  struct worker *next; /* takes the connection over as soon as its handle is closed */

  uv_buf_t unsent;    /* what transport_send() has still to write */
  bool peer_done;     /* whether the peer has shut down its side, so that nothing more arrives */
  bool stopping;      /* whether the daemon stops */
  unsigned unread;    /* bytes that had arrived when transport_drain() was called, or 1 with TLS */
  bool closing;       /* whether the connection ends, and its handle is being closed */
  uint64_t active_ms; /* when bytes were last received or sent, or as the owner sets it */
};

static inline struct transport *transport_of(struct client *client) {
  return (struct transport *)(void *)client;
}

/* Returns the time of the loop. */
static inline uint64_t transport_now_ms(const struct transport *transport) {
  return uv_now(transport->uv.handle.loop);
}

/* Sets up a transport, all of whose members are 0. It takes over a connected stream socket, and the
 * session, which may be NULL. */
void transport_init(struct transport *transport, const struct client_kind *kind,
                    const struct transport_calls *calls, struct server *server, int fd,
                    struct tls_session *session);

/* Opens it on the worker's thread. If that fails, logs why, ends the connection, and returns false. */
bool transport_open(struct transport *transport);

/* Begins or ceases to call received(). */
void transport_set_reading(struct transport *transport, bool wanted);

/* Writes as much of the buffers as the socket takes at once, and returns the number of bytes. If the
 * socket takes nothing, transport->writing becomes true; the first bytes of the buffers must then stay
 * where they are until sent() is called. */
uint64_t transport_write(struct transport *transport, const uv_buf_t *buffers, unsigned count);

/* Writes these bytes, as fast as the socket takes them; the next ones may follow when unsent.len is 0.
 * They stay where they are until then. Gives the client a turn when more has been written; sent() is
 * not called. */
void transport_send(struct transport *transport, void *bytes, size_t count);

/* Begins to end a client that reads on while `unread` is above 0: the bytes that have arrived by now. */
void transport_drain(struct client *client);

/* Ends the connection so that the peer can read the last reply. Closing a socket that has unread bytes
 * would reset the connection, and the peer might lose that reply. So this shuts down the sending side
 * only, when nothing is being written, and drops bytes until the peer closes, or transport_is_over(). */
void transport_linger(struct transport *transport);

/* Returns whether the connection ends, which a tick has to see to no more. */
bool transport_is_over(struct transport *transport, uint64_t now_ms);

/* Hands the connection over to another worker, which starts the client again. Nothing is being written,
 * and nothing but the workers calls the client. Returns false, and does nothing, if the daemon stops or
 * has no descriptor left. */
bool transport_move(struct transport *transport, struct worker *to);

/* Ends the connection at once: closes the socket, and frees the session. */
void transport_abort(struct transport *transport);
void transport_abort_client(struct client *client);

/* Logs why the connection ends. */
void transport_log_end(const struct transport *transport, const char *reason);

#endif
