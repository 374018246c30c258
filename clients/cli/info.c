/* dipole info: the daemon's lists, limits and statistics; dipole media: its measured media. */
#include <math.h>
#include <stdlib.h>

#include "clients/cli/daemon.h"
#include "clients/cli/profile.h"
#include "clients/cli/rows.h"

/* What the daemon's lists are called. */
static const char *const lists[] = {
#define WIRE_LIST(kind, IDENT, name, plural, list) [DIPOLE_##IDENT] = plural,
#include "proto/messages.def"
};

/* Something that is known about the daemon. */
typedef struct fact {
  const char *section, *name;
  const char *text; /* NULL for a count */
  uint64_t count;
} fact;

typedef struct facts {
  size_t count;
  fact *items;
} facts;

static void add_fact(facts *all, fact one) {
  all->items = cli_resize(all->items, all->count + 1, sizeof *all->items);
  all->items[all->count++] = one;
}

static void add_values(facts *all, const char *section, const dipole_value *values, size_t count) {
  for (size_t i = 0; i < count; i++) {
    add_fact(all, (fact){section, values[i].name, .count = values[i].value});
  }
}

static facts gather(const dipole_info *info, const dipole_value *statistics, size_t count) {
  facts all = {0};
  add_fact(&all, (fact){"daemon", "software", .text = info->software});
  add_fact(&all, (fact){"daemon", "address", .text = info->address});
  add_fact(&all, (fact){"daemon", "protocol_version", .count = info->protocol_version});
  add_fact(&all, (fact){"daemon", "instruction_set", .text = info->instruction_set});
  add_fact(&all, (fact){"daemon", "workers", .count = info->workers});
  add_fact(&all, (fact){"daemon", "R_unit", .text = info->R_unit});
  for (unsigned kind = 1; kind < sizeof lists / sizeof lists[0]; kind++) {
    const dipole_choice *choice;
    for (size_t from = 0;
         (choice = cli_next_choice(info, (enum dipole_kind)kind, &from)) != NULL;) {
      add_fact(&all, (fact){lists[kind], choice->name, choice->about, 0});
    }
  }
  add_values(&all, "limits", info->limits, info->limit_count);
  add_values(&all, "statistics", statistics, count);
  return all;
}

/* Writes a fact; people see the name of its section once. */
static void put_fact(cli_rows *rows, const void *context, size_t index) {
  const facts *all = context;
  const fact *one = &all->items[index];
  const bool again = rows->form == CLI_TABLE && index > 0 && one[-1].section == one->section;
  cli_put_text(rows, again ? "" : one->section, "section");
  cli_put_text(rows, one->name, "name");
  if (one->text != NULL) {
    cli_put_text(rows, one->text, "value");
  } else {
    cli_put_count(rows, one->count, "value");
  }
}

static int run_info(const cli_settings *settings, dipole_client *client) {
  dipole_value *statistics;
  dipole_error error;
  size_t count;
  if (!dipole_statistics(client, &statistics, &count, &error)) {
    return cli_fail_error(&error);
  }
  facts all = gather(dipole_get_info(client), statistics, count);
  const cli_report report = {.rows = all.count, .put_row = put_fact, .left = 3};
  cli_write(&report, settings->form, &all);
  free(statistics);
  return CLI_OK;
}

const cli_command cli_command_info = {
    .name = "info",
    .about = "Show a daemon: models, evaluators, instruction set, limits, statistics",
    .formats = "table,csv,json",
    .shows_service = true,
    .run = run_info,
    .examples = "  dipole info\n"
                "  dipole info --connect tcp:farm7:4817 --format json\n"
                "  watch -d 'dipole info --format csv | grep ^statistics'\n",
};

/* ---- media ----------------------------------------------------------------------------------- */

/* Writes one channel of a medium, whose name people see once. */
static void put_channel(cli_rows *rows, const void *context, size_t index) {
  const dipole_measured_medium *media = context;
  const size_t channel = index % CLI_COLOURS;
  const bool again = rows->form == CLI_TABLE && channel > 0;
  cli_put_text(rows, again ? "" : media[index / CLI_COLOURS].name, "medium");
  cli_put_text(rows, cli_colours[channel], "channel");
  const uint32_t layers = media[index / CLI_COLOURS].layer_count;
  const dipole_medium *medium = &media[index / CLI_COLOURS].channel[channel * layers];
  const dipole_medium none = {(double)NAN, (double)NAN, (double)NAN, (double)NAN, 0};
  if (layers > 1 && rows->form == CLI_TABLE) {
    for (size_t i = 0; i < 4; i++) {
      cli_put_text(rows, "", "");
    }
  } else {
    cli_put_medium(rows, layers == 1 ? medium : &none, 1);
  }
  cli_put_layers(rows, medium, layers > 1 ? layers : 0);
}

static int run_media(const cli_settings *settings, dipole_client *client) {
  dipole_measured_medium *media;
  dipole_error error;
  size_t count;
  if (!dipole_media(client, &media, &count, &error)) {
    return cli_fail_error(&error);
  }
  const cli_report report = {.rows = count * CLI_COLOURS, .put_row = put_channel, .left = 2};
  cli_write(&report, settings->form, media);
  free(media);
  return CLI_OK;
}

const cli_command cli_command_media = {
    .name = "media",
    .about = "List the media with names: their coefficients, or layers",
    .more =
        "Half spaces are those of Jensen et al. 2001, who measured sigma_s (1 - g): sigma_s holds "
        "it, with g = 0. Layers, as --layer takes them, are skin of types I-II (light), III-IV "
        "(medium) and V-VI (dark) at 610, 550 and 460 nm, after Jacques 2013.",
    .formats = "table,csv,json",
    .run = run_media,
    .examples = "  dipole media\n"
                "  dipole media --format csv\n",
};
