#include "server/observe/log.h"

#include <pthread.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

static enum log_level highest = LOG_LEVEL_INFO;

static const char *const level_names[] = {"error", "info"};

/* How many peer lines were printed in the current second, and how many were suppressed. */
static struct {
  pthread_mutex_t mutex;
  time_t second;
  unsigned printed;
  unsigned long suppressed;
} budget = {.mutex = PTHREAD_MUTEX_INITIALIZER};

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

static void print(enum log_level level, unsigned long suppressed, const char *format,
                  va_list arguments) {
  char text[512];
  char line[1024];
  struct timespec now;
  struct tm utc;
  vsnprintf(text, sizeof text, format, arguments);
  clock_gettime(CLOCK_REALTIME, &now);
  gmtime_r(&now.tv_sec, &utc);
  size_t length = strftime(line, sizeof line, "ts=%Y-%m-%dT%H:%M:%S", &utc);
  length += (size_t)snprintf(line + length, sizeof line - length, ".%03ldZ level=%s ",
                             now.tv_nsec / 1000000, level_names[level]);
  length += escape(text, line + length, sizeof line - length - 40);
  if (suppressed > 0) {
    length += (size_t)snprintf(line + length, sizeof line - length, " suppressed=%lu", suppressed);
  }
  line[length++] = '\n';
  /* One write() of the whole line keeps the lines of several threads apart. Its failure cannot be
   * reported anywhere. */
  const ssize_t written = write(STDERR_FILENO, line, length);
  (void)written;
}

void log_line(enum log_level level, const char *format, ...) {
  if (level > highest) {
    return;
  }
  va_list arguments;
  va_start(arguments, format);
  print(level, 0, format, arguments);
  va_end(arguments);
}

/* Returns whether a peer line may be printed now. If so, *suppressed is the number of lines before
 * it that were not printed. */
static bool spend(unsigned long *suppressed) {
  const time_t second = time(NULL);
  pthread_mutex_lock(&budget.mutex);
  if (second != budget.second) {
    budget.second = second;
    budget.printed = 0;
  }
  const bool allowed = budget.printed < LOG_PEER_LINES_PER_SECOND;
  if (allowed) {
    budget.printed++;
    *suppressed = budget.suppressed;
    budget.suppressed = 0;
  } else {
    budget.suppressed++;
  }
  pthread_mutex_unlock(&budget.mutex);
  return allowed;
}

void log_peer_line(enum log_level level, const char *format, ...) {
  unsigned long suppressed = 0;
  if (level > highest || !spend(&suppressed)) {
    return;
  }
  va_list arguments;
  va_start(arguments, format);
  print(level, suppressed, format, arguments);
  va_end(arguments);
}
