/* dipole info: the daemon, what it offers, its limits, its statistics
 * and what evaluating costs. */
#include <stdlib.h>
#include <string.h>

#include "clients/cli/daemon.h"
#include "clients/cli/rows.h"

/* The daemon's lists, and what people call them. */
static const struct {
  enum dipole_kind kind;
  const char *plural;
} lists[] = {
    {DIPOLE_MODEL, "models"},
    {DIPOLE_EVALUATOR, "evaluators"},
    {DIPOLE_MOMENTS, "moments"},
    {DIPOLE_QUANTITY, "quantities"},
    {DIPOLE_SPACING, "spacings"},
    {DIPOLE_STATUS, "statuses"},
    {DIPOLE_PARAMETER, "parameters"},
    {DIPOLE_NOTE, "notes"},
    {DIPOLE_DRAW, "draws"},
    {DIPOLE_LENGTH, "lengths"},
    {DIPOLE_PHASE, "phases"},
    {DIPOLE_SCALE, "scales"},
    {DIPOLE_LIGHT, "lights"},
    {DIPOLE_COEFFICIENT, "coefficients"},
    {DIPOLE_AXIS, "axes"},
    {DIPOLE_FIT_STATUS, "fit statuses"},
    {DIPOLE_VALUE, "value statuses"},
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
  const dipole_info *info;
  dipole_offer *offers; /* of all models and evaluators, for their costs */
  size_t offer_count;
} facts;

#define COSTS "costs"
enum { COSTS_OF_OFFER = 2 }; /* that of a value and that of preparing */

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

/* ---- what evaluating costs ------------------------------------------------------------------- */

/* Asks for the offers of one precision and appends them. The costs of offers for a tolerance that
 * is as small as this one are those by default. */
static bool ask_costs(dipole_client *client, unsigned evaluator, facts *all, dipole_error *error) {
  const unsigned tolerance = dipole_id(client, DIPOLE_PARAMETER, "tolerance");
  const dipole_parameter parameter = {tolerance, 1e-5};
  const dipole_medium medium = {.sigma_a_per_mm = 0.05, .sigma_s_per_mm = 1, .eta = 1.4};
  const dipole_query query = {.model = DIPOLE_ANY_MODEL,
                              .evaluator = evaluator,
                              .moments = dipole_id(client, DIPOLE_MOMENTS, "exact"),
                              .wanted = DIPOLE_R,
                              .media = &medium,
                              .medium_count = 1,
                              .spacing = DIPOLE_LINEAR,
                              .radius_count = 1,
                              .radius_start_mm = 1,
                              .radius_stop_mm = 1,
                              .parameters = &parameter,
                              .parameter_count = 1};
  dipole_offer *offers;
  size_t count;
  if (!dipole_offers(client, &query, &offers, &count, NULL, error)) {
    return false;
  }
  all->offers = cli_resize(all->offers, all->offer_count + count, sizeof *all->offers);
  memcpy(all->offers + all->offer_count, offers, count * sizeof *offers);
  all->offer_count += count;
  free(offers);
  return true;
}

static int by_model(const void *a, const void *b) {
  const dipole_offer *x = a, *y = b;
  return x->model != y->model ? (x->model > y->model) - (x->model < y->model)
                              : (x->evaluator > y->evaluator) - (x->evaluator < y->evaluator);
}

static bool gather_costs(dipole_client *client, facts *all, dipole_error *error) {
  all->info = dipole_get_info(client);
  const bool good =
      ask_costs(client, DIPOLE_F64, all, error) && ask_costs(client, DIPOLE_F32, all, error);
  if (good) {
    qsort(all->offers, all->offer_count, sizeof *all->offers, by_model);
  }
  return good;
}

static const char *name_of(const facts *all, enum dipole_kind kind, unsigned id) {
  const dipole_choice *choice = cli_choice_of_id(all->info, kind, id);
  return choice != NULL ? choice->name : "?";
}

/* Puts the costs of an offer, for people and in JSON. */
static void put_offer(cli_rows *rows, const void *context, size_t index) {
  const facts *all = context;
  const dipole_offer *offer = &all->offers[index];
  cli_put_text(rows, CLI_COLUMN("model"), name_of(all, DIPOLE_MODEL, offer->model));
  cli_put_text(rows, CLI_COLUMN("evaluator"), name_of(all, DIPOLE_EVALUATOR, offer->evaluator));
  cli_put_number(rows, CLI_COLUMN("cost_ns", "a value", "ns", "%.3g"), offer->cost_ns);
  cli_put_number(rows, CLI_COLUMN("prepare_ns", "to prepare a medium", "ns", "%.3g"),
                 offer->prepare_ns);
}

/* Puts one cost of an offer, in CSV. */
static void put_cost(cli_rows *rows, const facts *all, size_t index) {
  const dipole_offer *offer = &all->offers[index / COSTS_OF_OFFER];
  const bool prepare = index % COSTS_OF_OFFER == 1;
  char name[128];
  snprintf(name, sizeof name, "%s %s %s", name_of(all, DIPOLE_MODEL, offer->model),
           name_of(all, DIPOLE_EVALUATOR, offer->evaluator), prepare ? "prepare_ns" : "cost_ns");
  cli_put_text(rows, CLI_COLUMN("section"), COSTS);
  cli_put_text(rows, CLI_COLUMN("name"), name);
  cli_put_number(rows, CLI_COLUMN("value"), prepare ? offer->prepare_ns : offer->cost_ns);
}

/* ---- writing --------------------------------------------------------------------------------- */

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
  puts("\n" COSTS ", as measured on one machine");
  cli_rows_print(stdout, 2, all->offer_count, put_offer, all);
}

static void put_value(cli_rows *rows, const char *name, const fact *one) {
  if (one->text != NULL) {
    cli_put_text(rows, CLI_COLUMN(name), one->text);
  } else {
    cli_put_count(rows, CLI_COLUMN(name), one->count);
  }
}

static void put_fact(cli_rows *rows, const void *context, size_t index) {
  const facts *all = context;
  if (index >= all->count) {
    put_cost(rows, all, index - all->count);
    return;
  }
  const fact *one = &all->items[index];
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
  cli_rows_json(json, COSTS, all->offer_count, put_offer, all);
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
  const bool good = gather_costs(client, &all, &error);
  if (good) {
    const cli_output output = {.table = write_table,
                               .rows = all.count + COSTS_OF_OFFER * all.offer_count,
                               .put_row = put_fact,
                               .members = put_members};
    cli_write(&output, common->form, &all);
  }
  free(all.offers);
  free(all.items);
  free(statistics);
  return good ? CLI_OK : cli_fail_error(&error);
}

const cli_command cli_command_info = {
    .name = "info",
    .about = "Show a daemon: models, evaluators, instruction set, limits, statistics, costs",
    .formats = "table,csv,json",
    .shows_service = true,
    .settings_bytes = sizeof(cli_common),
    .run = run,
    .examples = "  dipole info\n"
                "  dipole info --connect tcp:farm7:4817 --format json\n",
};
