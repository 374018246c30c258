/* listener: an address at which clients connect. Listeners belong to the main thread's loop. */
#ifndef DIPOLED_LISTENER_H
#define DIPOLED_LISTENER_H

#include "server/net/tcp.h"
#include "server/net/tls.h"
#include "server/server.h"

/* Gets, and then owns, a connected socket. */
typedef void listener_take(struct server *server, int fd);

struct listener {
  struct server *server;
  listener_take *admit;
  uv_poll_t poll;
  uv_timer_t pause;
  uint64_t pause_logged_ms; /* when a pause was last logged; 0 if never */
  int fd;
  char *unix_path;   /* the socket file to remove in the end; NULL for TCP and adopted sockets */
  dev_t unix_device; /* identity of the socket file */
  ino_t unix_inode;
};

/* Listens at unix:PATH, tcp:HOST:PORT or tls:HOST:PORT, at each address of HOST, and logs them.
 * modbus: takes the connections of Modbus, which has no unix:PATH; NULL: the binary protocol. Returns
 * the number of listeners that it opened. If it fails, prints a message to standard error and returns
 * 0. */
size_t listener_open(struct listener listeners[TCP_ADDRESSES_MAX], struct server *server,
                     uv_loop_t *loop, const char *url, listener_take *modbus);

/* Listens at the [HOST]:PORT of an option, at each address of HOST, and logs them as OPTION:HOST:PORT.
 * admit: takes the connections. Returns and prints as listener_open(). */
size_t listener_open_option(struct listener listeners[TCP_ADDRESSES_MAX], struct server *server,
                            uv_loop_t *loop, const char *option, const char *address,
                            listener_take *admit);

/* Makes a listener of a stream socket (Unix or TCP) that already listens, and logs its address. The
 * socket's file, if any, stays when the listener is closed. If fd is no such socket, closes fd,
 * prints a message to standard error and returns false. */
bool listener_adopt(struct listener *listener, struct server *server, uv_loop_t *loop, int fd);

/* Stops listening. libuv closes the handles in the loop's next round. */
void listener_close(struct listener *listener);

/* Gives a connected socket to a worker, or refuses it if there are too many connections or its peer
 * is not allowed. Any thread may call these. */
void listener_admit(struct server *server, int fd, bool inherited);
/* The same with a session of TLS whose handshake is done, which is then no longer the caller's. */
void listener_admit_tls(struct server *server, int fd, struct tls_session *session);

#endif
