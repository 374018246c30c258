/* dipole info: the daemon, what it offers, its limits and its statistics. */
#include <stdlib.h>
#include <string.h>

#include "clients/cli/daemon.h"
#include "clients/cli/rows.h"

/* The daemon's lists, and what people call them. */
static const struct {
  enum dipole_kind kind;
  const char *plural;
} lists[] = {
    {DIPOLE_MODEL, "models"},         {DIPOLE_EVALUATOR, "evaluators"}, {DIPOLE_MOMENTS, "moments"},
    {DIPOLE_QUANTITY, "quantities"},  {DIPOLE_SPACING, "spacings"},     {DIPOLE_STATUS, "statuses"},
    {DIPOLE_PARAMETER, "parameters"}, {DIPOLE_NOTE, "notes"},           {DIPOLE_DRAW, "draws"},
    {DIPOLE_LENGTH, "lengths"},       {DIPOLE_PHASE, "phases"},
};

#define DAEMON "daemon"

/* Something that is known about the daemon. */
typedef struct fact {
  const char *section;
  const char *name, *head; /* for programs and for people */
  const dipole_choice *choice;
  const char *text; /* NULL for a count */
  uint64_t count;
} fact;

typedef struct facts {
  size_t count;
  fact *items;
} facts;

static void add(facts *all, fact one) {
  all->items = cli_resize(all->items, all->count + 1, sizeof *all->items);
  all->items[all->count++] = one;
}

static void add_values(facts *all, const char *section, const dipole_value *values, size_t count) {
  for (size_t i = 0; i < count; i++) {
    add(all, (fact){section, values[i].name, values[i].name, .count = values[i].value});
  }
}

static facts gather(const dipole_info *info, const dipole_value *statistics, size_t count) {
  facts all = {0};
  add(&all, (fact){DAEMON, "software", "daemon", .text = info->software});
  add(&all, (fact){DAEMON, "address", "address", .text = info->address});
  add(&all,
      (fact){DAEMON, "protocol_version", "protocol version", .count = info->protocol_version});
  add(&all, (fact){DAEMON, "instruction_set", "instruction set", .text = info->instruction_set});
  add(&all, (fact){DAEMON, "workers", "workers", .count = info->workers});
  add(&all, (fact){DAEMON, "R_unit", "unit of R", .text = info->R_unit});
  for (size_t i = 0; i < sizeof lists / sizeof lists[0]; i++) {
    const dipole_choice *choice;
    for (size_t from = 0; (choice = cli_next_choice(info, lists[i].kind, &from)) != NULL;) {
      add(&all, (fact){lists[i].plural, choice->name, choice->name, choice, choice->about, 0});
    }
  }
  add_values(&all, "limits", info->limits, info->limit_count);
  add_values(&all, "statistics", statistics, count);
  return all;
}

/* Returns how many facts, from `first` on, are in the same section. */
static size_t section_length(const facts *all, size_t first) {
  size_t end = first;
  while (end < all->count && strcmp(all->items[end].section, all->items[first].section) == 0) {
    end++;
  }
  return end - first;
}

static void write_table(const void *context) {
  const facts *all = context;
  for (size_t first = 0, length; first < all->count; first += length) {
    const bool daemon = first == 0;
    cli_table table = {.columns = daemon ? 2 : 3,
                       .left = daemon || all->items[first].text != NULL ? 3 : 2};
    length = section_length(all, first);
    if (!daemon) {
      printf("\n%s\n", all->items[first].section);
    }
    for (const fact *one = &all->items[first]; one < &all->items[first + length]; one++) {
      if (!daemon) {
        cli_table_add(&table, " ");
      }
      cli_table_add(&table, "%s", one->head);
      if (one->text != NULL) {
        cli_table_add(&table, "%s", one->text);
      } else {
        cli_table_add(&table, "%llu", (unsigned long long)one->count);
      }
    }
    cli_table_print(&table, stdout);
  }
}

static void put_value(cli_rows *rows, const char *name, const fact *one) {
  if (one->text != NULL) {
    cli_put_text(rows, CLI_COLUMN(name), one->text);
  } else {
    cli_put_count(rows, CLI_COLUMN(name), one->count);
  }
}

static void put_fact(cli_rows *rows, const void *context, size_t index) {
  const fact *one = &((const facts *)context)->items[index];
  cli_put_text(rows, CLI_COLUMN("section"), one->section);
  cli_put_text(rows, CLI_COLUMN("name"), one->name);
  put_value(rows, "value", one);
}

static void put_choice(cli_rows *rows, const void *context, size_t index) {
  const fact *one = (const fact *)context + index;
  cli_put_count(rows, CLI_COLUMN("id"), one->choice->id);
  cli_put_text(rows, CLI_COLUMN("name"), one->name);
  cli_put_text(rows, CLI_COLUMN("about"), one->text);
}

static void put_member(cli_rows *rows, const void *context, size_t index) {
  const fact *one = (const fact *)context + index;
  put_value(rows, one->name, one);
}

static void put_members(cli_json *json, const void *context) {
  const facts *all = context;
  for (size_t first = 0, length; first < all->count; first += length) {
    const fact *first_fact = &all->items[first];
    length = section_length(all, first);
    if (first_fact->choice != NULL) {
      cli_rows_json(json, first_fact->section, length, put_choice, first_fact);
      continue;
    }
    if (first > 0) { /* the daemon's own members belong to the outermost object */
      cli_json_begin(json, first_fact->section, '{');
    }
    for (size_t i = 0; i < length; i++) {
      cli_rows_members(json, put_member, first_fact, i);
    }
    if (first > 0) {
      cli_json_end(json, '}');
    }
  }
}

static int run(void *settings, dipole_client *client) {
  const cli_common *common = settings;
  dipole_value *statistics;
  dipole_error error;
  size_t count;
  if (!dipole_statistics(client, &statistics, &count, &error)) {
    return cli_fail_error(&error);
  }
  facts all = gather(dipole_get_info(client), statistics, count);
  const cli_output output = {
      .table = write_table, .rows = all.count, .put_row = put_fact, .members = put_members};
  cli_write(&output, common->form, &all);
  free(all.items);
  free(statistics);
  return CLI_OK;
}

const cli_command cli_command_info = {
    .name = "info",
    .about = "Show a daemon: models, evaluators, instruction set, limits, statistics",
    .formats = "table,csv,json",
    .settings_bytes = sizeof(cli_common),
    .run = run,
    .examples = "  dipole info\n"
                "  dipole info --connect tcp:farm7:4817 --format json\n",
};
