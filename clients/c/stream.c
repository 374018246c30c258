#include "clients/c/stream.h"

#include <assert.h>
#include <errno.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include "clients/c/clock.h"
#include "clients/c/error.h"
#include "proto/wire.h"

/* The stream frees its output buffer when that is empty and larger than this. */
#define OUTPUT_KEPT_BYTES ((size_t)1 << 20)

void libdipole_stream_init(libdipole_stream *stream, int fd) {
  stream->fd = fd;
  stream->tls = NULL;
  stream->address[0] = '\0';
  stream->send_errno = 0;
  stream->heard = stream->silent = false;
  stream->out = NULL;
  stream->out_begin = stream->out_end = stream->out_capacity = 0;
  stream->target = NULL;
  stream->target_bytes = 0;
  stream->in_begin = stream->in_end = 0;
}

void libdipole_stream_close(libdipole_stream *stream, bool is_ours) {
  libdipole_tls_free(stream->tls, is_ours);
  if (stream->fd >= 0) {
    if (is_ours) {
      shutdown(stream->fd, SHUT_RDWR);
    }
    close(stream->fd);
  }
  free(stream->out);
  libdipole_stream_init(stream, -1);
}

static bool fail_lost(const libdipole_stream *stream, int number, dipole_error *error) {
  char what[192];
  snprintf(what, sizeof what, "the connection to the daemon%s%s was lost",
           stream->address[0] != '\0' ? " at " : "", stream->address);
  return libdipole_fail_errno(error, DIPOLE_ERROR_CONNECTION, number, what);
}

/* These two functions alone move bytes through the socket. */
static ssize_t send_some(libdipole_stream *stream, const uint8_t *from, size_t bytes) {
  return stream->tls != NULL ? libdipole_tls_write(stream->tls, from, bytes)
                             : send(stream->fd, from, bytes, MSG_NOSIGNAL);
}

static ssize_t receive_some(libdipole_stream *stream, uint8_t *to, size_t bytes) {
  return stream->tls != NULL ? libdipole_tls_read(stream->tls, to, bytes)
                             : recv(stream->fd, to, bytes, 0);
}

bool libdipole_stream_wait(const libdipole_stream *stream, short events, unsigned timeout_ms,
                           short *ready) {
  if (stream->tls != NULL && libdipole_tls_pending(stream->tls)) {
    *ready = POLLIN;
    return true;
  }
  return libdipole_wait(stream->fd, events, timeout_ms, ready);
}

/* Fails after reading failed: the connection is lost, or the daemon refused the certificate. */
static bool fail_received(const libdipole_stream *stream, dipole_error *error) {
  const int number = errno;
  const char *refusal =
      number == EPROTO && stream->tls != NULL ? libdipole_tls_refusal(stream->tls) : NULL;
  if (refusal == NULL) {
    return fail_lost(stream, number, error);
  }
  const bool none = strstr(refusal, "certificate required") != NULL;
  libdipole_fail(
      error, DIPOLE_ERROR_CONNECTION, "the daemon at %s %s%s", stream->address,
      none ? "requires a certificate: give one and its key, as with --certificate and --key"
           : "refuses this client's certificate: ",
      none ? "" : refusal);
  error->status = WIRE_STATUS_NOT_ALLOWED;
  return false;
}

bool libdipole_stream_reserve(libdipole_stream *stream, size_t bytes, dipole_error *error) {
  const size_t unsent = stream->out_end - stream->out_begin;
  if (bytes <= stream->out_capacity - stream->out_end) {
    return true;
  }
  if (stream->out_begin > 0) {
    memmove(stream->out, stream->out + stream->out_begin, unsent);
    stream->out_begin = 0;
    stream->out_end = unsent;
  }
  if (bytes <= stream->out_capacity - unsent) {
    return true;
  }
  const size_t twice = stream->out_capacity > SIZE_MAX / 2 ? SIZE_MAX : 2 * stream->out_capacity;
  if (bytes > SIZE_MAX - unsent) {
    return libdipole_fail_memory(error);
  }
  const size_t capacity = unsent + bytes > twice ? unsent + bytes : twice;
  uint8_t *out = realloc(stream->out, capacity);
  if (out == NULL) {
    return libdipole_fail(error, DIPOLE_ERROR_MEMORY, "out of memory: %zu bytes for a request",
                          capacity);
  }
  stream->out = out;
  stream->out_capacity = capacity;
  return true;
}

void libdipole_stream_send(libdipole_stream *stream) {
  const size_t unsent = stream->out_end - stream->out_begin;
  if (unsent == 0 || stream->send_errno != 0) {
    return;
  }
  const ssize_t sent = send_some(stream, stream->out + stream->out_begin, unsent);
  if (sent < 0) {
    if (errno != EAGAIN && errno != EINTR) {
      stream->send_errno = errno;
    }
    return;
  }
  stream->out_begin += (size_t)sent;
  if (stream->out_begin == stream->out_end) {
    stream->out_begin = stream->out_end = 0;
    if (stream->out_capacity > OUTPUT_KEPT_BYTES) {
      free(stream->out);
      stream->out = NULL;
      stream->out_capacity = 0;
    }
  }
}

/* Reads once: into the target if there is one, else into the input buffer, which has room. */
static bool receive(libdipole_stream *stream, dipole_error *error) {
  uint8_t *to = stream->target;
  size_t room = stream->target_bytes;
  if (room == 0) {
    const size_t unread = stream->in_end - stream->in_begin;
    memmove(stream->in, stream->in + stream->in_begin, unread);
    stream->in_begin = 0;
    stream->in_end = unread;
    to = stream->in + unread;
    room = sizeof stream->in - unread;
  }
  assert(room > 0); /* The caller leaves at most an incomplete header in the buffer. */
  const ssize_t got = receive_some(stream, to, room);
  if (got < 0) {
    return errno == EAGAIN || errno == EINTR || fail_received(stream, error);
  }
  if (got == 0) {
    return stream->send_errno != 0
               ? fail_lost(stream, stream->send_errno, error)
               : libdipole_fail(
                     error, DIPOLE_ERROR_CONNECTION,
                     "the daemon, or a proxy, closed the connection%s%s without a reason%s",
                     stream->address[0] != '\0' ? " at " : "", stream->address,
                     !stream->heard && strncmp(stream->address, "tcp:", 4) == 0
                         ? ": is it a tls: address?"
                         : "");
  }
  stream->heard = true;
  if (stream->target_bytes > 0) {
    stream->target += got;
    stream->target_bytes -= (size_t)got;
  } else {
    stream->in_end += (size_t)got;
  }
  return true;
}

bool libdipole_stream_step(libdipole_stream *stream, unsigned timeout_ms, dipole_error *error) {
  const bool sending = stream->out_end > stream->out_begin && stream->send_errno == 0;
  short ready;
  if (!libdipole_stream_wait(stream, (short)(POLLIN | (sending ? POLLOUT : 0)), timeout_ms,
                             &ready)) {
    stream->silent = errno == ETIMEDOUT;
    return libdipole_fail_errno(error, DIPOLE_ERROR_CONNECTION, errno, "poll");
  }
  if ((ready & ~POLLOUT) != 0 && !receive(stream, error)) { /* recv() also reports POLLERR. */
    return false;
  }
  if ((ready & POLLOUT) != 0) {
    libdipole_stream_send(stream);
  }
  return true;
}
