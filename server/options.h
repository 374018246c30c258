/* options: the values of dipoled's options, from the command line and the environment. */
#ifndef DIPOLED_OPTIONS_H
#define DIPOLED_OPTIONS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { OPTIONS_LIST_MAX = 32 };

struct options_list {
  const char *items[OPTIONS_LIST_MAX];
  size_t count;
  char *copy; /* copy of the environment's text, which holds the items */
};

#define SERVER_NUMBER(field, name, default_value, least, most, help) uint64_t field;
#define SERVER_TEXT(field, name, value, help) const char *field;
#define SERVER_LIST(field, name, value, separators, help) struct options_list field;
struct options {
#include "server/options.def"
};

enum options_outcome { OPTIONS_RUN, OPTIONS_EXIT_OK, OPTIONS_EXIT_USAGE };

/* Reads the environment and then the command line, which takes precedence. Prints the help or the
 * version if it is requested, or an error. Texts point into argv and the environment. */
enum options_outcome options_read(int argc, char **argv, struct options *options);

void options_free(struct options *options);

/* Reads the lines of a file that an option names: read(context, line) returns what is wrong with one,
 * or NULL. Returns false, and says why with the number of the line, if one is wrong or too long, or the
 * file cannot be read. */
bool options_read_lines(const char *path, const char *(*read)(void *context, char *line),
                        void *context, char *why, size_t why_bytes);

/* Calls each(context, name, value) for every number. In the name, underscores replace hyphens. */
void options_each_number(const struct options *options,
                         void (*each)(void *context, const char *name, uint64_t value),
                         void *context);

#endif
