#include "server/net/roles.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "server/options.h"

enum { ENTRIES_MAX = 1000 };

enum kind { EVERYBODY, SUBJECT, ROLE };

struct entry {
  unsigned roles;
  enum kind kind;
  char *name; /* name that a certificate must have; NULL: everybody */
};

struct roles {
  size_t count;
  struct entry entries[ENTRIES_MAX];
};

static const struct {
  enum role role;
  const char *name;
} names[] = {{ROLE_EVALUATE, "evaluate"},
             {ROLE_COMPUTE, "compute"},
             {ROLE_OBSERVE, "observe"},
             {ROLE_READ, "read"},
             {ROLE_WRITE, "write"}};

enum { NAMES = sizeof names / sizeof names[0] };

const char *roles_name(unsigned role) {
  size_t i = 0;
  while (i + 1 < NAMES && names[i].role != role) {
    i++;
  }
  return names[i].name;
}

/* ---- the file -------------------------------------------------------------------------------- */

/* Reads a list of roles, as "evaluate,observe". Returns what is wrong, or NULL. */
static const char *read_roles(char *text, struct entry *entry) {
  static const char what[] = "write roles first: evaluate, compute, observe, read or write, with "
                             "commas between them";
  char *rest = text;
  for (char *one = strtok_r(text, ",", &rest); one != NULL; one = strtok_r(NULL, ",", &rest)) {
    size_t i = 0;
    while (i < NAMES && strcmp(one, names[i].name) != 0) {
      i++;
    }
    if (i == NAMES) {
      return what;
    }
    entry->roles |= names[i].role;
  }
  return entry->roles == 0 ? what : NULL;
}

/* Returns a copy of a subject as RFC 2253 lets tls.c write it: \C3\A9 in place of the two bytes of
 * an e with an accent. NULL: out of memory. */
static char *copy_subject(const char *from) {
  char *copy = malloc(3 * strlen(from) + 1), *to = copy;
  for (; copy != NULL && *from != '\0'; from++) {
    const unsigned char byte = (unsigned char)*from;
    to += byte < 0x80 ? snprintf(to, 2, "%c", byte) : snprintf(to, 4, "\\%02X", byte);
  }
  if (copy != NULL) {
    *to = '\0';
  }
  return copy;
}

/* Reads who is meant. Returns what is wrong, or NULL. */
static const char *read_who(const char *who, struct entry *entry) {
  static const char subject[] = "subject:", role[] = "role:";
  const char *name = NULL;
  if (strcmp(who, "*") == 0) {
    entry->kind = EVERYBODY;
    return NULL;
  }
  if (strncmp(who, subject, strlen(subject)) == 0) {
    entry->kind = SUBJECT;
    name = who + strlen(subject);
  } else if (strncmp(who, role, strlen(role)) == 0) {
    entry->kind = ROLE;
    name = who + strlen(role);
  }
  if (name == NULL || *name == '\0') {
    return "write subject:TEXT, role:NAME or * behind the roles";
  }
  entry->name = entry->kind == SUBJECT ? copy_subject(name) : strdup(name);
  return entry->name != NULL ? NULL : "out of memory";
}

/* Reads one line. Returns what is wrong, or NULL. */
static const char *read_line(void *context, char *line) {
  struct roles *roles = context;
  static const char blanks[] = " \t\r\n";
  line += strspn(line, blanks);
  for (size_t end = strlen(line); end > 0 && strchr(blanks, line[end - 1]) != NULL;) {
    line[--end] = '\0';
  }
  if (*line == '\0' || *line == '#') {
    return NULL;
  }
  if (roles->count == ENTRIES_MAX) {
    return "the file has too many lines";
  }
  char *who = line + strcspn(line, blanks);
  if (*who != '\0') {
    *who++ = '\0';
    who += strspn(who, blanks);
  }
  struct entry *entry = &roles->entries[roles->count];
  *entry = (struct entry){0};
  const char *wrong = read_roles(line, entry);
  wrong = wrong != NULL ? wrong : read_who(who, entry);
  roles->count += wrong == NULL;
  return wrong;
}

struct roles *roles_read(const char *path, char *why, size_t why_bytes) {
  struct roles *roles = calloc(1, sizeof *roles);
  if (roles == NULL) {
    snprintf(why, why_bytes, "out of memory");
  } else if (!options_read_lines(path, read_line, roles, why, why_bytes)) {
    roles_free(roles);
    roles = NULL;
  }
  return roles;
}

void roles_free(struct roles *roles) {
  for (size_t i = 0; roles != NULL && i < roles->count; i++) {
    free(roles->entries[i].name);
  }
  free(roles);
}

static bool names_client(const struct entry *entry, const char *subject, const char *role) {
  return entry->kind == EVERYBODY ||
         strcmp(entry->kind == SUBJECT ? subject : role, entry->name) == 0;
}

unsigned roles_of(const struct roles *roles, const char *subject, const char *role) {
  unsigned sum = 0;
  for (size_t i = 0; i < roles->count; i++) {
    if (names_client(&roles->entries[i], subject, role)) {
      sum |= roles->entries[i].roles;
    }
  }
  return sum;
}
