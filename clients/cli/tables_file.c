#include "clients/cli/tables_file.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

void cli_tables_add(cli_tables *tables, dipole_table *table) {
  tables->items = cli_resize(tables->items, tables->count + 1, sizeof *tables->items);
  tables->items[tables->count++] = table;
}

void cli_tables_free(cli_tables *tables) {
  for (size_t i = 0; i < tables->count; i++) {
    dipole_table_free(tables->items[i]);
  }
  *tables = (cli_tables){0};
}

static bool is_standard(const char *path) {
  return strcmp(path, "-") == 0;
}

/* ---- reading --------------------------------------------------------------------------------- */

/* Returns the whole of a file, to be freed; NULL if it cannot be read. */
static char *read_whole(FILE *from, size_t *count) {
  size_t capacity = 1 << 16, got;
  char *bytes = cli_allocate(capacity, 1);
  *count = 0;
  while ((got = fread(bytes + *count, 1, capacity - *count, from)) > 0) {
    *count += got;
    if (*count == capacity) {
      capacity *= 2;
      bytes = cli_resize(bytes, capacity, 1);
    }
  }
  if (ferror(from)) {
    return NULL;
  }
  return bytes;
}

static bool take_tables(const char *path, const char *bytes, size_t count, cli_tables *tables) {
  size_t done = 0;
  do {
    dipole_table *table;
    dipole_error error;
    size_t table_bytes;
    if (!dipole_table_load(bytes + done, count - done, &table, &error)) {
      cli_fail("%s: table %zu: %s", path, tables->count + 1, error.text);
      return false;
    }
    cli_tables_add(tables, table);
    dipole_table_bytes(table, &table_bytes);
    done += table_bytes;
  } while (done < count);
  return true;
}

bool cli_tables_read(const char *path, cli_tables *tables) {
  FILE *from = is_standard(path) ? stdin : fopen(path, "rbe");
  size_t count = 0;
  char *bytes = from != NULL ? read_whole(from, &count) : NULL;
  const int read_errno = errno;
  if (from != NULL && from != stdin) {
    fclose(from);
  }
  if (bytes == NULL) {
    cli_fail("cannot read %s: %s", path, strerror(read_errno));
    return false;
  }
  const bool good = take_tables(path, bytes, count, tables);
  return good;
}

/* ---- writing --------------------------------------------------------------------------------- */

static bool write_all(const cli_tables *tables, FILE *to) {
  for (size_t i = 0; i < tables->count; i++) {
    size_t count;
    const void *bytes = dipole_table_bytes(tables->items[i], &count);
    if (fwrite(bytes, 1, count, to) != count) {
      return false;
    }
  }
  return fflush(to) == 0;
}

bool cli_tables_save(const char *path, const cli_tables *tables) {
  FILE *to = is_standard(path) ? stdout : fopen(path, "wbe");
  if (to == NULL) {
    cli_fail("cannot write %s: %s", path, strerror(errno));
    return false;
  }
  const bool terminal = isatty(fileno(to)) == 1;
  bool written = !terminal && write_all(tables, to);
  const int write_errno = errno;
  if (to != stdout && fclose(to) != 0) {
    written = false;
  }
  if (terminal) {
    cli_fail("--output %s: a terminal cannot show binary tables; name a file", path);
  } else if (!written) {
    cli_fail("cannot write %s: %s", path, strerror(write_errno));
  }
  return written;
}
