/* transport: the bytes of one connection on its socket, plain or by TLS. It is the only place where
 * the binary protocol and Modbus are read from and written to a socket. A plain socket is a stream of libuv,
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

#include "server/net/tls.h"

/* What the transport calls. `owner` is that of transport_open(). */
struct transport_calls {
  /* Sets *room to memory for the next bytes and returns how many fit; 0 if there is none. */
  size_t (*room)(void *owner, uint8_t **room);
  /* This many bytes have arrived in that memory. Or, if negative: UV_EOF, the peer has shut down
   * its sending side; UV_ENOBUFS, there was no room. */
  void (*received)(void *owner, ssize_t bytes);
  /* The write that transport_write() has begun has ended: this many more bytes are written. */
  void (*sent)(void *owner, uint64_t bytes);
  void (*failed)(void *owner); /* nothing can be sent or received; calls transport_close() */
  void (*closed)(void *owner); /* called last, after transport_close() */
};

struct transport {
  union {
    uv_handle_t handle;
    uv_stream_t stream;
    uv_tcp_t tcp;
    uv_pipe_t pipe;
    uv_poll_t poll; /* with TLS */
  } uv;
  const struct transport_calls *calls;
  void *owner;
  int fd;
  struct tls_session *tls; /* NULL: the bytes are plain */
  uv_write_t write;
  uv_shutdown_t shutdown;
  uint64_t writing_bytes; /* number of bytes that libuv has still to write */
  bool writing;           /* whether the call of sent() is still to come */
  bool reading;
  bool lingering; /* see transport_linger() */
  bool has_more;  /* with TLS: whether OpenSSL may hold bytes for which there was no time or room */
  bool tells_empty; /* TLS only: see transport_tell_empty() */
  bool blocked;     /* with TLS: whether reading waits until the socket can be written to */
  int events;       /* TLS only: events for which the poll waits */
};

/* Takes over a connected stream socket, and the session, which may be NULL. The result may be an
 * error of libuv; the caller calls transport_close() in any case. */
int transport_open(struct transport *transport, uv_loop_t *loop, int fd,
                   struct tls_session *session, const struct transport_calls *calls, void *owner);

/* Begins or ceases to call received(). */
void transport_set_reading(struct transport *transport, bool wanted);

/* Writes as much of the buffers as the socket takes at once, and returns the number of bytes. If the
 * socket takes nothing, transport->writing becomes true; the first bytes of the buffers must then stay
 * where they are until sent() is called. */
uint64_t transport_write(struct transport *transport, const uv_buf_t *buffers, unsigned count);

/* With TLS, calls received() with 0 bytes if reading is wanted and all bytes that have arrived were
 * read. */
void transport_tell_empty(struct transport *transport);

/* Ends the connection so that the peer can read the last reply. Closing a socket that has unread bytes
 * would reset the connection, and the peer might lose that reply. So this shuts down the sending side
 * only, when nothing is being written, and drops bytes until the peer closes: failed() is then called.
 * The owner closes after a while in any case. */
void transport_linger(struct transport *transport);

/* Closes the socket, and frees the session. */
void transport_close(struct transport *transport);

#endif
