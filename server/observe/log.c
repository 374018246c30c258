#include "server/observe/log.h"

#include <errno.h>
#include <poll.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

enum {
  LINES = 128, /* most lines that may wait for standard error */
  LINE_BYTES = 1024,
  LAST_LINES_S = 1, /* time that the last lines may take when the daemon ends */
};

static enum log_level highest = LOG_LEVEL_INFO;

static const char *const level_names[] = {"error", "info"};

struct line {
  char text[LINE_BYTES];
  size_t length;
  uint64_t dropped; /* number of dropped lines that this line reports */
};

/* Lines wait for a thread that does nothing but write them, since standard error may hold it up: a
 * pipe that nobody reads, a stopped terminal, a slow disk. */
static struct {
  pthread_mutex_t mutex;
  pthread_cond_t changed;
  struct line lines[LINES];
  size_t first, count;
  uint64_t dropped;        /* number of lines that were dropped in all */
  uint64_t dropped_before; /* number of those that no line has reported yet */
  uint64_t suppressed;     /* peer lines beyond LOG_PEER_LINES_PER_SECOND, likewise */
  time_t second;
  unsigned printed; /* number of peer lines in this second */
} queue = {.mutex = PTHREAD_MUTEX_INITIALIZER, .changed = PTHREAD_COND_INITIALIZER};

void log_set_level(enum log_level level) {
  highest = level;
}

bool log_level_by_name(const char *name, enum log_level *level) {
  for (int i = LOG_LEVEL_ERROR; i <= LOG_LEVEL_INFO; i++) {
    if (strcmp(name, level_names[i]) == 0) {
      *level = (enum log_level)i;
      return true;
    }
  }
  return false;
}

/* Copies text and escapes bytes that are not printable. Returns the length of the copy, which has
 * no end of line. */
static size_t escape(const char *text, char *line, size_t room) {
  size_t length = 0;
  for (; *text != '\0' && length + 5 < room; text++) {
    const unsigned char c = (unsigned char)*text;
    if (c >= 0x20 && c < 0x7f) {
      line[length++] = (char)c;
    } else {
      length += (size_t)snprintf(line + length, room - length, "\\x%02x", c);
    }
  }
  return length;
}

/* Adds " KEY=COUNT" to a line, unless the count is 0. */
static void add_count(struct line *line, const char *key, uint64_t count) {
  if (count > 0) {
    line->length += (size_t)snprintf(line->text + line->length, LINE_BYTES - line->length,
                                     " %s=%llu", key, (unsigned long long)count);
  }
}

static void fill_line(struct line *line, const struct timespec *now, enum log_level level,
                      const char *format, va_list arguments) {
  char text[512];
  struct tm utc;
  vsnprintf(text, sizeof text, format, arguments);
  gmtime_r(&now->tv_sec, &utc);
  line->length = strftime(line->text, LINE_BYTES, "ts=%Y-%m-%dT%H:%M:%S", &utc);
  line->length += (size_t)snprintf(line->text + line->length, LINE_BYTES - line->length,
                                   ".%03ldZ level=%s ", now->tv_nsec / 1000000, level_names[level]);
  line->length += escape(text, line->text + line->length, LINE_BYTES - line->length - 80);
}

/* Counts a peer line. Returns whether it may be printed. */
static bool spend(time_t second) {
  if (second != queue.second) {
    queue.second = second;
    queue.printed = 0;
  }
  return queue.printed < LOG_PEER_LINES_PER_SECOND && ++queue.printed > 0;
}

static void print(enum log_level level, bool by_peer, const char *format, va_list arguments) {
  struct timespec now;
  if (level > highest) {
    return;
  }
  clock_gettime(CLOCK_REALTIME, &now);
  pthread_mutex_lock(&queue.mutex);
  if (by_peer && !spend(now.tv_sec)) {
    queue.suppressed++;
  } else if (queue.count == LINES) {
    queue.dropped++;
    queue.dropped_before++;
  } else {
    struct line *line = &queue.lines[(queue.first + queue.count++) % LINES];
    fill_line(line, &now, level, format, arguments);
    if (by_peer) {
      add_count(line, "suppressed", queue.suppressed);
      queue.suppressed = 0;
    }
    add_count(line, "dropped", queue.dropped_before);
    line->dropped = queue.dropped_before;
    queue.dropped_before = 0;
    line->text[line->length++] = '\n';
    pthread_cond_broadcast(&queue.changed);
  }
  pthread_mutex_unlock(&queue.mutex);
}

void log_line(enum log_level level, const char *format, ...) {
  va_list arguments;
  va_start(arguments, format);
  print(level, false, format, arguments);
  va_end(arguments);
}

void log_peer_line(enum log_level level, const char *format, ...) {
  va_list arguments;
  va_start(arguments, format);
  print(level, true, format, arguments);
  va_end(arguments);
}

/* ---- writing --------------------------------------------------------------------------------- */

/* One write() of the whole line keeps the lines of several programs apart. */
static bool write_line(const struct line *line) {
  size_t done = 0;
  while (done < line->length) {
    const ssize_t written = write(STDERR_FILENO, line->text + done, line->length - done);
    if (written >= 0) {
      done += (size_t)written;
    } else if (errno == EAGAIN) {
      poll(&(struct pollfd){.fd = STDERR_FILENO, .events = POLLOUT}, 1, -1);
    } else if (errno != EINTR) {
      return false;
    }
  }
  return true;
}

static void *write_lines(void *unused) {
  pthread_mutex_lock(&queue.mutex);
  for (;;) {
    while (queue.count == 0) {
      pthread_cond_wait(&queue.changed, &queue.mutex);
    }
    const struct line *line = &queue.lines[queue.first];
    pthread_mutex_unlock(&queue.mutex);
    const bool written = write_line(line);
    pthread_mutex_lock(&queue.mutex);
    if (!written) {
      queue.dropped++;
      queue.dropped_before += 1 + line->dropped;
    }
    queue.first = (queue.first + 1) % LINES;
    queue.count--;
    pthread_cond_broadcast(&queue.changed);
  }
  return unused;
}

int log_start(void) {
  pthread_t thread;
  const int error = pthread_create(&thread, NULL, write_lines, NULL);
  return error != 0 ? error : pthread_detach(thread);
}

void log_finish(void) {
  struct timespec end;
  int late = 0;
  clock_gettime(CLOCK_MONOTONIC, &end);
  end.tv_sec += LAST_LINES_S;
  pthread_mutex_lock(&queue.mutex);
  while (queue.count > 0 && late == 0) {
    late = pthread_cond_clockwait(&queue.changed, &queue.mutex, CLOCK_MONOTONIC, &end);
  }
  pthread_mutex_unlock(&queue.mutex);
}

uint64_t log_dropped_lines(void) {
  pthread_mutex_lock(&queue.mutex);
  const uint64_t dropped = queue.dropped;
  pthread_mutex_unlock(&queue.mutex);
  return dropped;
}
