#include "clients/cli/daemon.h"

#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "clients/cli/options.h"

/* The time within which a running daemon replies. */
#define AT_ONCE_MS 1000

static void take_options(const cli_settings *settings, dipole_options *options) {
  dipole_options_init(options);
  options->timeout_ms = (unsigned)settings->timeout_ms.value;
  if (settings->timeout_ms.given) {
    options->connect_timeout_ms = options->timeout_ms;
  }
  if (settings->retry_ms.given) {
    options->retry_ms = (unsigned)settings->retry_ms.value;
  }
  options->ca = settings->ca;
  options->certificate = settings->certificate;
  options->key = settings->key;
}

/* Opens a client. Prints a message at a terminal when no daemon replies at once. */
static bool open_client(const cli_settings *settings, const char *address, dipole_client **client,
                        dipole_error *error) {
  dipole_options options;
  take_options(settings, &options);
  const bool is_private = address == NULL || strncmp(address, "private:", strlen("private:")) == 0;
  if (!is_private && options.retry_ms > 0 && isatty(STDERR_FILENO) == 1) {
    dipole_options at_once = options;
    at_once.retry_ms = 0;
    at_once.connect_timeout_ms = AT_ONCE_MS;
    if (dipole_open_with(settings->connect, &at_once, client, error)) {
      dipole_set_retry_ms(*client, options.retry_ms);
      return true;
    }
    if (error->kind == DIPOLE_ERROR_CONNECT) {
      fprintf(stderr, "%s. Trying for another %g s, see --retry-ms.\n", error->text,
              options.retry_ms / 1e3);
    }
  }
  return dipole_open_with(settings->connect, &options, client, error);
}

dipole_client *cli_open(const cli_settings *settings) {
  dipole_client *client;
  dipole_error error;
  const char *address = settings->connect != NULL ? settings->connect : getenv("DIPOLED");
  if (open_client(settings, address, &client, &error)) {
    /* for private: addresses, dipole_open_with() ignores retry_ms */
    if (settings->retry_ms.given) {
      dipole_set_retry_ms(client, (unsigned)settings->retry_ms.value);
    }
    return client;
  }
  cli_fail("%s", error.text);
  if (error.kind == DIPOLE_ERROR_CONNECT && error.status == 0 && address != NULL &&
      strncmp(address, "private:", strlen("private:")) != 0 && !settings->is_service) {
    const bool several = strstr(address, ",unix:") != NULL || strstr(address, ",tcp:") != NULL ||
                         strstr(address, ",tls:") != NULL;
    fprintf(stderr,
            "The address is from %s. If no daemon runs there, start one with `dipoled --listen "
            "%s`. Or %s: dipole then starts a daemon for itself.\n",
            settings->connect != NULL ? "--connect" : "the environment variable DIPOLED",
            several ? "ADDRESS" : address,
            settings->connect != NULL ? "leave --connect out" : "unset that variable");
  }
  return NULL;
}

bool cli_try_again(const cli_settings *settings, int64_t start_ms, const dipole_error *error) {
  const uint64_t busy_ms = (uint64_t)(cli_now_ms() - start_ms);
  const bool is_patient = settings->retry_ms.given ? busy_ms < settings->retry_ms.value
                                                   : settings->timeout_ms.value == 0 ||
                                                         busy_ms < settings->timeout_ms.value;
  if (error->retry_after_ms == 0 || !is_patient) {
    return false;
  }
  const uint32_t nap_ms = error->retry_after_ms < 1000 ? error->retry_after_ms : 1000;
  const struct timespec nap = {.tv_sec = nap_ms / 1000, .tv_nsec = (nap_ms % 1000) * 1000000L};
  nanosleep(&nap, NULL);
  return true;
}

int cli_fail_error_of(const char *what, const dipole_error *error) {
  const bool of_layer = strstr(error->text, " of layer ") != NULL;
  const cli_option *option = cli_options_find(of_layer ? "layer" : error->field);
  return option != NULL ? cli_fail("%s%s (--%s)", what, error->text, option->name)
                        : cli_fail("%s%s", what, error->text);
}

int cli_fail_error(const dipole_error *error) {
  return cli_fail_error_of("", error);
}

/* ---- names ----------------------------------------------------------------------------------- */

const dipole_choice *cli_next_choice(const dipole_info *info, enum dipole_kind kind, size_t *from) {
  while (*from < info->choice_count) {
    const dipole_choice *choice = &info->choices[(*from)++];
    if (choice->kind == kind) {
      return choice;
    }
  }
  return NULL;
}

const dipole_choice *cli_choice(const dipole_info *info, enum dipole_kind kind, const char *name) {
  const dipole_choice *choice;
  size_t from = 0;
  do {
    choice = cli_next_choice(info, kind, &from);
  } while (choice != NULL && strcmp(choice->name, name) != 0);
  return choice;
}

const dipole_choice *cli_choice_of_id(const dipole_info *info, enum dipole_kind kind, unsigned id) {
  const dipole_choice *choice;
  size_t from = 0;
  do {
    choice = cli_next_choice(info, kind, &from);
  } while (choice != NULL && choice->id != id);
  return choice;
}

const dipole_choice *cli_next_note(const dipole_info *info, unsigned notes, size_t *from) {
  const dipole_choice *note;
  do {
    note = cli_next_choice(info, DIPOLE_NOTE, from);
  } while (note != NULL && (note->id == 0 || (notes & note->id) != note->id));
  return note;
}

uint64_t cli_limit(const dipole_info *info, const char *name, uint64_t otherwise) {
  size_t i = 0;
  while (i < info->limit_count && strcmp(info->limits[i].name, name) != 0) {
    i++;
  }
  return i < info->limit_count ? info->limits[i].value : otherwise;
}

void cli_list_names(const dipole_info *info, enum dipole_kind kind, char *text, size_t bytes) {
  static const char more[] = ", ...";
  const dipole_choice *choice;
  size_t length = 0;
  text[0] = '\0';
  for (size_t from = 0; (choice = cli_next_choice(info, kind, &from)) != NULL;) {
    const size_t added = strlen(choice->name) + (length > 0 ? strlen(", ") : 0);
    if (length + added + sizeof more > bytes) {
      snprintf(text + length, bytes - length, "%s", more);
      return;
    }
    length += (size_t)snprintf(text + length, bytes - length, "%s%s", length > 0 ? ", " : "",
                               choice->name);
  }
}

const dipole_choice *cli_named(const dipole_info *info, enum dipole_kind kind, const char *option,
                               const char *name) {
  char known[1024];
  const dipole_choice *choice = cli_choice(info, kind, name);
  if (choice == NULL) {
    cli_nearest nearest = {0};
    size_t from = 0;
    while ((choice = cli_next_choice(info, kind, &from)) != NULL) {
      cli_nearest_try(&nearest, name, choice->name, 1 + strlen(choice->name) / 4);
    }
    cli_list_names(info, kind, known, sizeof known);
    cli_fail_usage("--%s: '%s' is unknown; this daemon has %s%s%s%s", option, name, known,
                   nearest.name != NULL ? ". Is it " : "", nearest.name != NULL ? nearest.name : "",
                   nearest.name != NULL ? "?" : "");
  }
  return choice;
}
