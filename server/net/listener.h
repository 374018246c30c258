/* listener: an address that clients connect to. On main's loop. */
#ifndef DIPOLED_LISTENER_H
#define DIPOLED_LISTENER_H

#include "server/server.h"

struct listener {
  struct server *server;
  void (*admit)(struct server *server, int fd); /* owns the connected socket */
  uv_poll_t poll;
  uv_timer_t pause;
  int fd;
  char *unix_path; /* removed when the listener is closed; NULL for TCP and adopted sockets */
};

/* Starts to listen at unix:PATH or tcp:HOST:PORT and logs the address. False, with a message on
 * standard error, when that cannot be done. */
bool listener_open(struct listener *listener, struct server *server, uv_loop_t *loop,
                   const char *url);

/* Takes over a stream socket (Unix or TCP) that is bound and listens already, and logs its address;
 * its file, if it has one, stays when the listener is closed. False, with a message on standard
 * error, when fd is none such: it is closed then, too. */
bool listener_adopt(struct listener *listener, struct server *server, uv_loop_t *loop, int fd);

/* As listener_open(), for Modbus at tcp:HOST:PORT. */
bool listener_open_modbus(struct listener *listener, struct server *server, uv_loop_t *loop,
                          const char *url);

/* No more connections from here. The handles close with the loop's next round. */
void listener_close(struct listener *listener);

/* Gives a connected socket to a worker, or refuses it when there are too many. */
void listener_admit(struct server *server, int fd, bool inherited);

#endif
