#include "server/net/listener.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include "server/net/connection.h"
#include "server/net/handshake.h"
#include "server/net/tcp.h"
#include "server/net/worker.h"
#include "server/observe/health.h"
#include "server/observe/log.h"

enum {
  BACKLOG = 1024,
  ACCEPTS_PER_ROUND = 64,
  PAUSE_MS = 100,        /* pause before accepting again when no file descriptor is left */
  PAUSE_LOG_MS = 10000,  /* how often such pauses are logged while they last */
  REFUSALS_AT_ONCE = 64, /* refused connections that a worker serves; more are closed at once */
};

static bool complain(const char *url, const char *why) {
  fprintf(stderr, "dipoled: cannot listen at %s: %s\n", url, why);
  return false;
}

/* ---- admission ------------------------------------------------------------------------------- */

/* Returns the number of connections of the binary protocol that all workers have, including those
 * that are being refused. */
static uint64_t held_connections(const struct server *server) {
  uint64_t held = -stats_get(&server->stats, STATS_SCPI_CONNECTIONS_OPEN);
  for (uint64_t i = 0; i < server->options.workers; i++) {
    held += server->workers[i].client_count;
  }
  return held;
}

/* Sends the error and closes the socket. A new socket always has room for this frame. A peer that
 * has already sent something may not get the frame, because closing then resets the connection. */
static void refuse_at_once(struct server *server, int fd, struct tls_session *session,
                           enum connection_purpose purpose) {
  const wire_header header = {.magic = WIRE_MAGIC,
                              .version = WIRE_VERSION,
                              .type = WIRE_TYPE_ERROR,
                              .payload_bytes = WIRE_BYTES_error};
  const wire_error error = connection_refusal(purpose);
  health_note_refusal(server, &error);
  uint8_t frame[WIRE_BYTES_header + WIRE_BYTES_error];
  wire_put_header(frame, &header);
  wire_put_error(frame + WIRE_BYTES_header, &error);
  const ssize_t sent = session != NULL ? tls_session_write(session, frame, sizeof frame)
                                       : send(fd, frame, sizeof frame, MSG_NOSIGNAL | MSG_DONTWAIT);
  if (sent == (ssize_t)sizeof frame) {
    stats_count_reply(&server->stats, error.status);
  }
  tls_session_free(session);
  close(fd);
}

static void give_to_worker(struct server *server, int fd, struct tls_session *session,
                           bool inherited) {
  struct stats *stats = &server->stats;
  const bool full = stats_get(stats, STATS_CONNECTIONS_OPEN) >= server->options.max_connections;
  const bool forbidden = !inherited && !access_allows_peer(&server->allow, fd);
  const bool refused = full || forbidden;
  const enum connection_purpose purpose = forbidden   ? CONNECTION_FORBID
                                          : full      ? CONNECTION_REFUSE
                                          : inherited ? CONNECTION_INHERITED
                                                      : CONNECTION_SERVE;
  stats_add(stats, refused ? STATS_CONNECTIONS_REFUSED : STATS_CONNECTIONS_ACCEPTED, 1);
  const bool too_many_refusals =
      held_connections(server) >= server->options.max_connections + REFUSALS_AT_ONCE;
  struct client *connection =
      refused && too_many_refusals ? NULL : connection_new(server, fd, session, purpose);
  if (connection == NULL) {
    refuse_at_once(server, fd, session, purpose);
    return;
  }
  if (!refused) {
    stats_add(stats, STATS_CONNECTIONS_OPEN, 1);
  }
  worker_give(worker_least_busy(server), connection);
}

void listener_admit(struct server *server, int fd, bool inherited) {
  give_to_worker(server, fd, NULL, inherited);
}

void listener_admit_tls(struct server *server, int fd, struct tls_session *session) {
  give_to_worker(server, fd, session, false);
}

static void admit_socket(struct server *server, int fd) {
  listener_admit(server, fd, false);
}

static void on_pause_over(uv_timer_t *timer);

/* Stops accepting for a while. The connection keeps waiting, so the poll would return at once
 * again and again. */
static void pause_accepting(struct listener *listener, const char *reason) {
  const uint64_t now_ms = uv_now(listener->poll.loop);
  if (listener->pause_logged_ms == 0 || now_ms - listener->pause_logged_ms >= PAUSE_LOG_MS) {
    listener->pause_logged_ms = now_ms;
    log_peer_line(LOG_LEVEL_ERROR, "event=accept-paused reason=%s", reason);
  }
  uv_poll_stop(&listener->poll);
  uv_timer_start(&listener->pause, on_pause_over, PAUSE_MS, 0);
}

static void on_connections(uv_poll_t *poll, int status, int events) {
  (void)status;
  (void)events;
  struct listener *listener = poll->data;
  for (int i = 0; i < ACCEPTS_PER_ROUND; i++) {
    const int fd =
        tcp_has_descriptor() ? accept4(listener->fd, NULL, NULL, SOCK_NONBLOCK | SOCK_CLOEXEC) : -1;
    if (fd >= 0) {
      listener->admit(listener->server, fd);
    } else if (errno == EMFILE || errno == ENFILE || errno == ENOBUFS || errno == ENOMEM) {
      pause_accepting(listener, strerror(errno));
      return;
    } else if (errno == EAGAIN) {
      return;
    }
  }
}

static void on_pause_over(uv_timer_t *timer) {
  struct listener *listener = timer->data;
  uv_poll_start(&listener->poll, UV_READABLE, on_connections);
}

/* ---- Unix sockets ---------------------------------------------------------------------------- */

static int unix_socket(void) {
  return socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
}

/* Returns whether a path is a socket file at which nobody listens, as a killed daemon leaves it. */
static bool is_stale(const struct sockaddr_un *address) {
  struct stat status;
  if (lstat(address->sun_path, &status) != 0 || !S_ISSOCK(status.st_mode)) {
    return false;
  }
  const int fd = unix_socket();
  const bool refused =
      connect(fd, (const struct sockaddr *)address, sizeof *address) != 0 && errno == ECONNREFUSED;
  close(fd);
  return refused;
}

/* Remembers the identity of the socket's file: another daemon may replace it by its own file. */
static void note_file(struct listener *listener, const char *path) {
  struct stat status;
  if (lstat(path, &status) == 0) {
    listener->unix_path = strdup(path);
    listener->unix_device = status.st_dev;
    listener->unix_inode = status.st_ino;
  }
}

static void remove_file(struct listener *listener) {
  struct stat status;
  if (lstat(listener->unix_path, &status) == 0 && status.st_dev == listener->unix_device &&
      status.st_ino == listener->unix_inode) {
    unlink(listener->unix_path);
  }
  free(listener->unix_path);
}

static bool open_unix(struct listener *listener, const char *url, const char *path) {
  struct sockaddr_un address = {.sun_family = AF_UNIX};
  if (*path == '\0' || strlen(path) >= sizeof address.sun_path) {
    return complain(url, "the path is empty or longer than a socket's path may be (107 bytes)");
  }
  memcpy(address.sun_path, path, strlen(path) + 1);
  listener->fd = unix_socket();
  if (listener->fd < 0) {
    return complain(url, strerror(errno));
  }
  int bound = bind(listener->fd, (struct sockaddr *)&address, sizeof address);
  if (bound != 0 && errno == EADDRINUSE && is_stale(&address)) {
    unlink(path);
    bound = bind(listener->fd, (struct sockaddr *)&address, sizeof address);
  }
  if (bound != 0) {
    return complain(url, tcp_why_not(errno));
  }
  note_file(listener, path);
  if (listen(listener->fd, BACKLOG) != 0) {
    complain(url, strerror(errno));
    remove_file(listener);
    return false;
  }
  log_line(LOG_LEVEL_INFO, "event=listening url=unix:%s", path);
  return true;
}

/* ---- TCP ------------------------------------------------------------------------------------- */

/* Opens a listener for each address of a name. Returns how many. */
static size_t open_tcp(struct listener *listeners, const char *url, const char *host_port,
                       const char *protocol, const char *scheme) {
  const char *why;
  int fds[TCP_ADDRESSES_MAX];
  const size_t count = tcp_listen(host_port, fds, &why);
  for (size_t i = 0; i < count; i++) {
    char bound[TCP_TEXT_BYTES];
    listeners[i] = listeners[0];
    listeners[i].fd = fds[i];
    tcp_bound(fds[i], bound);
    log_line(LOG_LEVEL_INFO, "event=listening url=%s%s:%s", protocol, scheme, bound);
  }
  return count > 0 ? count : complain(url, why);
}

/* ---- passed sockets -------------------------------------------------------------------------- */

static int socket_option(int fd, int name) {
  int value = -1;
  socklen_t length = sizeof value;
  return getsockopt(fd, SOL_SOCKET, name, &value, &length) == 0 ? value : -1;
}

static void log_adopted(int fd) {
  char bound[TCP_TEXT_BYTES];
  tcp_bound(fd, bound);
  log_line(LOG_LEVEL_INFO, "event=listening url=%s%s",
           socket_option(fd, SO_DOMAIN) != AF_UNIX ? "tcp:" : "", bound);
}

static bool check_adopted(int fd) {
  const int domain = socket_option(fd, SO_DOMAIN);
  if (socket_option(fd, SO_TYPE) != SOCK_STREAM || socket_option(fd, SO_ACCEPTCONN) != 1 ||
      (domain != AF_UNIX && domain != AF_INET && domain != AF_INET6)) {
    char number[32];
    snprintf(number, sizeof number, "descriptor %d", fd);
    return complain(number, "it is no stream socket that listens");
  }
  return fcntl(fd, F_SETFL, O_NONBLOCK) == 0 && fcntl(fd, F_SETFD, FD_CLOEXEC) == 0;
}

/* ---- public ---------------------------------------------------------------------------------- */

static bool watch_listener(struct listener *listener, uv_loop_t *loop) {
  uv_poll_init(loop, &listener->poll, listener->fd);
  uv_timer_init(loop, &listener->pause);
  listener->poll.data = listener->pause.data = listener;
  return uv_poll_start(&listener->poll, UV_READABLE, on_connections) == 0;
}

bool listener_adopt(struct listener *listener, struct server *server, uv_loop_t *loop, int fd) {
  *listener = (struct listener){.server = server, .admit = admit_socket, .fd = fd};
  if (!check_adopted(fd)) {
    close(fd);
    return false;
  }
  log_adopted(fd);
  return watch_listener(listener, loop);
}

size_t listener_open(struct listener listeners[TCP_ADDRESSES_MAX], struct server *server,
                     uv_loop_t *loop, const char *url, listener_take *modbus) {
  const bool is_tls = strncmp(url, "tls:", 4) == 0;
  size_t count;
  listeners[0] = (struct listener){.server = server, .admit = modbus, .fd = -1};
  if (modbus == NULL) {
    listeners[0].admit = is_tls ? handshakes_admit : admit_socket;
  }
  if (is_tls || strncmp(url, "tcp:", 4) == 0) {
    count =
        open_tcp(listeners, url, url + 4, modbus != NULL ? "modbus-" : "", is_tls ? "tls" : "tcp");
  } else if (modbus == NULL && strncmp(url, "unix:", 5) == 0) {
    count = open_unix(&listeners[0], url, url + 5);
  } else {
    count = complain(
        url, modbus != NULL
                 ? "Modbus is served at tcp:HOST:PORT, tls:HOST:PORT or "
                   "rtu:DEVICE[,BAUD[,PARITY[,UNIT]]]"
                 : "write unix:PATH, tcp:HOST:PORT or tls:HOST:PORT, as in tcp:127.0.0.1:4817");
  }
  for (size_t i = 0; i < count; i++) {
    watch_listener(&listeners[i], loop);
  }
  if (count == 0 && listeners[0].fd >= 0) {
    close(listeners[0].fd);
  }
  return count;
}

size_t listener_open_option(struct listener listeners[TCP_ADDRESSES_MAX], struct server *server,
                            uv_loop_t *loop, const char *option, const char *address,
                            listener_take *admit) {
  int fds[TCP_ADDRESSES_MAX];
  const size_t count = tcp_listen_option(option, address, fds);
  for (size_t i = 0; i < count; i++) {
    char bound[TCP_TEXT_BYTES];
    listeners[i] = (struct listener){.server = server, .admit = admit, .fd = fds[i]};
    tcp_bound(fds[i], bound);
    log_line(LOG_LEVEL_INFO, "event=listening url=%s:%s", option, bound);
    watch_listener(&listeners[i], loop);
  }
  return count;
}

void listener_close(struct listener *listener) {
  uv_close((uv_handle_t *)&listener->poll, NULL);
  uv_close((uv_handle_t *)&listener->pause, NULL);
  if (listener->unix_path != NULL) {
    remove_file(listener); /* before the socket is closed, so that no other file has its inode */
  }
  close(listener->fd);
}
