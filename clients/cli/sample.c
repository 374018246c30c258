/* dipole sample: draws radii in proportion to the light that leaves there. */
#include <stdlib.h>
#include <string.h>

#include "clients/cli/daemon.h"
#include "clients/cli/number.h"
#include "clients/cli/profile.h"
#include "clients/cli/progress.h"
#include "clients/cli/rows.h"

#define DRAW_OF_A_LIST "list"

typedef struct sample_settings {
  cli_profile_settings profile;
  cli_numbers u;
  cli_count count, seed, first;
  const char *draw;
  cli_texts wanted;
} sample_settings;

#define FIELD(name) offsetof(sample_settings, name)

static const cli_option options[] = {
    {"Numbers", NULL, NULL, CLI_HEADING, 0, NULL},
    {"u", "X[,X...]", "take these numbers, from 0 (which gives 0 mm) to 1 (which gives inf)",
     CLI_NUMBERS, FIELD(u), NULL},
    {"count", "N", "how many numbers are drawn (default: 10)", CLI_COUNT, FIELD(count), "10"},
    {"draw", "NAME",
     "how to draw them. random; stratified: one in each of N equal intervals;\n"
     "regular: the middles of the intervals (default: random)",
     CLI_TEXT, FIELD(draw), NULL},
    {"seed", "N", "for random and stratified; the same seed gives the same bits (default: 1)",
     CLI_COUNT, FIELD(seed), "1"},
    {"first", "N", "for random: start with number N of the seed (default: 0)", CLI_COUNT,
     FIELD(first), NULL},
    {"Evaluation", NULL, NULL, CLI_HEADING, 0, NULL},
    {"model", "NAME", "a model that covers all radii; see `dipole info` (default: transport)",
     CLI_TEXT, FIELD(profile.model), CLI_MODEL_DEFAULT},
    {CLI_MOMENTS_OPTION, "exact"},
    {CLI_EVALUATOR_OPTION, NULL},
    {"wanted", "NAME[,NAME...]",
     "what to write. r: the radii; pdf: their density, 1/mm, which is 2 pi r\n"
     "times that of points on the surface; `dipole info` lists all, at these\n"
     "radii (default: r,pdf)",
     CLI_NAMES, FIELD(wanted), NULL},
    {CLI_DEADLINE_OPTION, NULL},
    {0},
};

typedef struct report {
  cli_profile profile;
  const dipole_choice *draw;
  cli_quantities quantities;
  dipole_sample_query query;
  size_t count;
  double *u;               /* [count] */
  dipole_result **results; /* [result_count]: PIECE_SAMPLES each, or one of all */
  size_t result_count;
  double *values; /* [count], for the values of one quantity and channel while they are written */
} report;

static int check(void *given) {
  const sample_settings *settings = given;
  const int status = cli_medium_check(&settings->profile);
  if (status != CLI_OK) {
    return status;
  }
  if (settings->u.count > 0 && (settings->count.given || settings->draw != NULL ||
                                settings->seed.given || settings->first.given)) {
    return cli_fail_usage("--u gives the numbers one by one: leave --count, --draw, "
                          "--seed and --first out");
  }
  return cli_deadline_check(&settings->profile);
}

/* ---- asking ---------------------------------------------------------------------------------- */

static int choose(const sample_settings *settings, report *of) {
  const char *draw = settings->draw != NULL ? settings->draw : "random";
  of->draw = cli_named(of->profile.info, DIPOLE_DRAW, "draw",
                       settings->u.count > 0 ? DRAW_OF_A_LIST : draw);
  if (of->draw == NULL) {
    return CLI_USAGE;
  }
  if (settings->u.count == 0 && of->draw->id == DIPOLE_DRAW_LIST) {
    return cli_fail_usage("--draw %s: give the numbers with --u", DRAW_OF_A_LIST);
  }
  return cli_quantities_take(of->profile.info, &settings->wanted, DIPOLE_RADIUS | DIPOLE_PDF,
                             DIPOLE_ALBEDO, &of->quantities)
             ? CLI_OK
             : CLI_USAGE;
}

/* Returns a copy of the listed numbers in the evaluator's precision. Free it. */
static void *list_numbers(const cli_numbers *u, bool single) {
  if (!single) {
    double *numbers = cli_allocate(u->count, sizeof *numbers);
    memcpy(numbers, u->items, u->count * sizeof *numbers);
    return numbers;
  }
  float *numbers = cli_allocate(u->count, sizeof *numbers);
  for (size_t i = 0; i < u->count; i++) {
    numbers[i] = (float)u->items[i];
  }
  return numbers;
}

/* Stores the numbers that radii were drawn with in of->u. numbers: the listed ones, or an array in
 * which the drawn ones are stored first. */
static bool keep_numbers(report *of, void *numbers, bool listed, bool single, dipole_error *error) {
  if (!listed && !dipole_sample_numbers(&of->query, 0, of->count, numbers, error)) {
    return false;
  }
  for (size_t i = 0; i < of->count; i++) {
    of->u[i] =
        single ? cli_number_of_single(((const float *)numbers)[i]) : ((const double *)numbers)[i];
  }
  return true;
}

static dipole_sample_query make_query(const sample_settings *settings, const report *of) {
  const cli_profile *profile = &of->profile;
  const bool seeded = of->draw->id == DIPOLE_DRAW_RANDOM || of->draw->id == DIPOLE_DRAW_STRATIFIED;
  return (dipole_sample_query){
      .model = profile->model->id,
      .evaluator = profile->evaluator->id,
      .moments = profile->moments->id,
      .wanted = of->quantities.wanted | DIPOLE_MODEL_ERROR,
      .media = profile->media,
      .medium_count = (uint32_t)profile->channel_count,
      .draw = of->draw->id,
      .sample_count = settings->u.count > 0 ? settings->u.count : settings->count.value,
      .sample_first = settings->first.value,
      /* A seed that has no use is sent if it was given, so that the daemon refuses it. */
      .seed = seeded || settings->seed.given ? settings->seed.value : 0,
      .parameters = profile->parameters.items,
      .parameter_count = profile->parameters.count,
      .deadline_ms = (unsigned)settings->profile.deadline_ms.value,
  };
}

/* Random numbers are asked for in pieces, which shows how far the work is. */
enum { PIECE_SAMPLES = 1 << 16 };

static bool ask_pieces(const sample_settings *settings, dipole_client *client, report *of,
                       dipole_error *error) {
  const uint64_t count = of->query.sample_count;
  const bool cut = of->query.draw == DIPOLE_DRAW_RANDOM && count > PIECE_SAMPLES;
  cli_progress progress;
  uint64_t first = 0;
  bool good;
  of->results = cli_allocate(cut ? count / PIECE_SAMPLES + 1 : 1, sizeof(dipole_result *));
  cli_progress_start(&progress, "radii");
  do {
    dipole_sample_query piece = of->query;
    piece.sample_first += first;
    piece.sample_count = cut && count - first > PIECE_SAMPLES ? PIECE_SAMPLES : count - first;
    good = CLI_ASK(&settings->profile.common, error,
                   dipole_sample(client, &piece, &of->results[of->result_count], error));
    of->result_count += good;
    first += piece.sample_count;
    cli_progress_show(&progress, (double)first / (double)count, (double)first);
  } while (good && first < count);
  cli_progress_wipe(&progress);
  return good;
}

static int ask(const sample_settings *settings, dipole_client *client, report *of) {
  const bool listed = settings->u.count > 0, single = of->profile.evaluator->id != DIPOLE_F64;
  void *numbers = listed ? list_numbers(&settings->u, single) : NULL;
  dipole_error error;
  of->query = make_query(settings, of);
  of->query.numbers = numbers;
  of->count = (size_t)of->query.sample_count;
  of->u = cli_allocate(of->count, sizeof *of->u);
  bool good = ask_pieces(settings, client, of, &error);
  if (good) {
    numbers = listed ? numbers : cli_allocate(of->count, sizeof(double));
    good = keep_numbers(of, numbers, listed, single, &error);
  }
  of->query.numbers = NULL;
  free(numbers);
  return good ? CLI_OK : cli_fail_error(&error);
}

/* Returns a value of the results. */
static double value_of(const report *of, size_t channel, unsigned quantity, size_t index) {
  const dipole_result *result = of->results[of->result_count > 1 ? index / PIECE_SAMPLES : 0];
  const size_t at = of->result_count > 1 ? index % PIECE_SAMPLES : index;
  const double *f64 = dipole_values_f64(result, (uint32_t)channel, quantity);
  return f64 != NULL
             ? f64[at]
             : cli_number_of_single(dipole_values_f32(result, (uint32_t)channel, quantity)[at]);
}

/* ---- writing --------------------------------------------------------------------------------- */

static bool has_albedo(const report *of) {
  return (of->query.wanted & DIPOLE_ALBEDO) != 0;
}

/* Writes a channel, and in JSON its samples. */
static void put_channel(cli_rows *rows, const void *context, size_t index) {
  const report *of = context;
  const dipole_channel *channel = &of->results[0]->channels[index];
  cli_put_text(rows, CLI_COLUMN("channel"), of->profile.channels[index].name);
  cli_put_medium(rows, &of->profile.media[index]);
  cli_put_number(rows, CLI_COLUMN("numerical_error", .forms = CLI_IN_JSON),
                 channel->numerical_error);
  cli_put_number(rows, CLI_COLUMN("numerical_error_per_mm", .forms = CLI_IN_JSON),
                 channel->numerical_error_per_mm);
  cli_put_number(rows,
                 CLI_COLUMN("model_error", "model error", "at drawn radii", "%.1e", "not solved"),
                 channel->model_error);
  if (has_albedo(of)) {
    cli_put_number(rows, CLI_COLUMN("albedo"), channel->albedo);
  }
  for (size_t q = 0; rows->form == CLI_JSON && q < of->quantities.count; q++) {
    for (size_t i = 0; i < of->count; i++) {
      of->values[i] = value_of(of, index, of->quantities.items[q]->id, i);
    }
    cli_json_numbers(rows->json, of->quantities.items[q]->name, of->values, of->count);
  }
}

/* Writes a number u and its values in all channels, for people. */
static void put_number(cli_rows *rows, const void *context, size_t index) {
  const report *of = context;
  cli_put_number(rows, CLI_COLUMN("u"), of->u[index]);
  for (size_t q = 0; q < of->quantities.count; q++) {
    const dipole_choice *quantity = of->quantities.items[q];
    const unsigned plain =
        DIPOLE_RADIUS | DIPOLE_CDF | DIPOLE_LN_R | DIPOLE_BY_SIGMA_A | DIPOLE_BY_SIGMA_S;
    for (size_t i = 0; i < of->profile.channel_count; i++) {
      char head[128];
      snprintf(head, sizeof head, "%s %s", quantity->name, of->profile.channels[i].name);
      cli_put_number(rows,
                     CLI_COLUMN(head, .unit = quantity->about,
                                .format = (quantity->id & plain) != 0 ? "%.6g" : "%.4e"),
                     value_of(of, i, quantity->id, index));
    }
  }
}

/* Writes a number u and its values in one channel, for CSV. */
static void put_sample(cli_rows *rows, const void *context, size_t index) {
  const report *of = context;
  const size_t channel = index / of->count, i = index % of->count;
  cli_put_text(rows, CLI_COLUMN("model"), of->profile.model->name);
  cli_put_text(rows, CLI_COLUMN("channel"), of->profile.channels[channel].name);
  cli_put_medium(rows, &of->profile.media[channel]);
  cli_put_number(rows, CLI_COLUMN("u"), of->u[i]);
  for (size_t q = 0; q < of->quantities.count; q++) {
    const dipole_choice *quantity = of->quantities.items[q];
    cli_put_number(rows, CLI_COLUMN(quantity->name), value_of(of, channel, quantity->id, i));
  }
  if (has_albedo(of)) {
    cli_put_number(rows, CLI_COLUMN("albedo"), of->results[0]->channels[channel].albedo);
  }
}

static void write_table(const void *context) {
  const report *of = context;
  const cli_profile *profile = &of->profile;
  cli_write_medium(profile, stdout);
  printf("radii drawn of the model %s; evaluator %s, moments %s", profile->model->name,
         profile->evaluator->name, profile->moments->name);
  cli_write_parameters(profile, stdout);
  printf("\nnumbers: %s", of->draw->name);
  if (of->query.seed != 0) {
    printf(", seed %llu", (unsigned long long)of->query.seed);
  }
  if (of->query.sample_first != 0) {
    printf(", from number %llu on", (unsigned long long)of->query.sample_first);
  }
  fputs("\n\n", stdout);
  if (of->quantities.count > 0) {
    cli_rows_print(stdout, 0, of->count, put_number, of);
    fputc('\n', stdout);
  }
  cli_rows_print(stdout, 1, profile->channel_count, put_channel, of);
  cli_write_launched(profile->media, profile->channel_count, stdout);
  cli_write_notes(profile->info, of->results[0]->notes, stdout);
}

static void put_members(cli_json *json, const void *context) {
  const report *of = context;
  const cli_profile *profile = &of->profile;
  cli_json_head(json, profile);
  cli_json_text(json, "model", profile->model->name);
  cli_json_text(json, "evaluator", profile->evaluator->name);
  cli_json_text(json, "moments", profile->moments->name);
  cli_json_text(json, "draw", of->draw->name);
  cli_json_count(json, "seed", of->query.seed);
  cli_json_count(json, "first", of->query.sample_first);
  cli_json_begin(json, "units", '{');
  cli_json_text(json, "sigma_a", "1/mm");
  cli_json_text(json, "sigma_s", "1/mm");
  cli_json_text(json, "u", "1");
  for (size_t q = 0; q < of->quantities.count; q++) {
    cli_json_text(json, of->quantities.items[q]->name, of->quantities.items[q]->about);
  }
  cli_json_end(json, '}');
  cli_json_notes(json, profile->info, of->results[0]->notes);
  cli_json_numbers(json, "u", of->u, of->count);
  cli_rows_json(json, "channels", profile->channel_count, put_channel, of);
}

/* ---- the command ----------------------------------------------------------------------------- */

static int ask_and_write(const sample_settings *settings, dipole_client *client, report *of) {
  cli_profile_settings profile = settings->profile;
  if (profile.evaluator == NULL) {
    profile.evaluator = cli_usual_evaluator(&profile, profile.model);
  }
  int status = cli_profile_take(&profile, client, &of->profile);
  status = status == CLI_OK ? choose(settings, of) : status;
  status = status == CLI_OK ? ask(settings, client, of) : status;
  if (status != CLI_OK) {
    return status;
  }
  of->values = cli_allocate(of->count, sizeof *of->values);
  const cli_output output = {.table = write_table,
                             .rows = of->profile.channel_count * of->count,
                             .put_row = put_sample,
                             .members = put_members};
  cli_write(&output, settings->profile.common.form, of);
  return status;
}

static int run(void *settings, dipole_client *client) {
  report of = {0};
  const int status = ask_and_write(settings, client, &of);
  cli_profile_free(&of.profile);
  free(of.u);
  free(of.values);
  for (size_t i = 0; i < of.result_count; i++) {
    dipole_result_free(of.results[i]);
  }
  free(of.results);
  return status;
}

const cli_command cli_command_sample = {
    .name = "sample",
    .about = "Draw radii in proportion to the light that leaves there",
    .more = "\n"
            "Each number u gives the radius within which the share u of the light leaves. So\n"
            "uniform numbers give radii in proportion to r R(r). All channels get the same\n"
            "numbers.\n" CLI_DEFAULT_TEXT,
    .formats = "table,csv,json",
    .options = {cli_medium_options, options, cli_parameter_options},
    .settings_bytes = sizeof(sample_settings),
    .check = check,
    .run = run,
    .examples = "  dipole sample --medium skin1\n"
                "  dipole sample --medium skin1 --u 0.1,0.5,0.9 --wanted r,pdf,R,cdf\n"
                "  dipole sample --sigma-a 0.01 --sigma-s 1 --count 1000 --draw stratified "
                "--seed 7 --format csv\n"
                "  dipole sample --medium marble --model burley --count 10000\n"
                "  dipole sample --medium skin1 --model better --evaluator f32 --count 1000\n",
};
