/* Compares kernels with what the processor can do: R at 1024 radii, which lie in the first cache, by
 * each instruction set of this machine with fused multiply-adds.
 *
 *   limit.<model>.<evaluator>.<instruction set>.cycles      cycles for one value
 *   limit.<model>.<evaluator>.<instruction set>.bound       the least by llvm-mca, whose units would
 *                                                           then never wait for a value
 *   ratio.limit.<model>.<evaluator>.<instruction set>       cycles over the bound
 *   limit.<model>.<evaluator>.<instruction set>.memcpy      cycles in which memcpy reads and writes the
 *                                                           bytes of one value: 4 or 8 each way
 *
 * llvm-mca reads the instructions that this program has executed: a child steps through the kernel,
 * one instruction after the other, and objdump names what stands at each address. Cycles are counted
 * in the time of a chain of multiplications, each of which takes three cycles.
 */
#include <inttypes.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/wait.h>
#include <unistd.h>

#include "core/core.h"
#include "tests/bench/bench.h"

enum { RADII = 1024, TRACED = 256, CHAIN = 4096, CYCLES_OF_A_PRODUCT = 3 };

/* The instruction sets that have them; the others call the C library for each. */
static const char *const fused[] = {"avx2", "avx512", "neon"};
enum { LEVELS = sizeof fused / sizeof fused[0] };

static const struct {
  unsigned model, evaluator;
} kernels[] = {
    {CORE_MODEL_BETTER, CORE_EVALUATOR_F32},    {CORE_MODEL_BETTER, CORE_EVALUATOR_F64},
    {CORE_MODEL_BURLEY, CORE_EVALUATOR_F32},    {CORE_MODEL_BURLEY, CORE_EVALUATOR_F64},
    {CORE_MODEL_SKIN_RED, CORE_EVALUATOR_F32},  {CORE_MODEL_SKIN_RED, CORE_EVALUATOR_F64},
    {CORE_MODEL_TRANSPORT, CORE_EVALUATOR_LUT}, {CORE_MODEL_TRANSPORT, CORE_EVALUATOR_F64},
};
enum { KERNELS = sizeof kernels / sizeof kernels[0] };

struct measured {
  char name[96];
  core_profile profile;
  double cycles, memcpy_cycles;
};

static _Alignas(BENCH_ALIGNMENT) double r[RADII], R[RADII];
static size_t radii = RADII;

static void run_kernel(const void *context) {
  const core_profile *profile = context;
  if (profile->evaluator == CORE_EVALUATOR_F64) {
    core_eval_f64(profile, CORE_QUANTITY_R, radii, r, R);
  } else {
    core_eval_f32(profile, CORE_QUANTITY_R, radii, (const float *)r, (float *)R);
  }
}

static void run_memcpy(const void *context) {
  memcpy(R, r, *(const size_t *)context);
  __asm__ volatile("" : : "r"(R) : "memory"); /* it is copied each time */
}

static void run_chain(const void *context) {
  (void)context;
  static volatile uint64_t seed = 3;
  uint64_t x = seed;
  for (int i = 0; i < CHAIN; i++) {
    x *= x;
    __asm__ volatile("" : "+r"(x)); /* each product is computed */
  }
  seed = x;
}

/* ---- what is executed ---------------------------------------------------------------------- */

/* Writes the address in the program's file of each instruction of the kernel, one on each line. */
static void write_trace(const core_profile *profile, FILE *trace) {
  extern const char __executable_start[], etext[];
  const uintptr_t start = (uintptr_t)__executable_start, end = (uintptr_t)etext;
  const pid_t child = fork();
  int status;
  if (child == 0) {
    ptrace(PTRACE_TRACEME, 0, NULL, NULL);
    radii = TRACED;
    raise(SIGTRAP);
    run_kernel(profile);
    __builtin_trap(); /* another signal */
  }
  siginfo_t stop;
  bool within = false;
  while (child > 0 && waitpid(child, &status, 0) == child && WIFSTOPPED(status) &&
         WSTOPSIG(status) == SIGTRAP && ptrace(PTRACE_GETSIGINFO, child, NULL, &stop) == 0) {
    const uintptr_t at = (uintptr_t)stop.si_addr;
    within = within || at == (uintptr_t)run_kernel;
    if (within && at >= start && at < end) {
      fprintf(trace, "%" PRIxPTR "\n", at - start);
    }
    ptrace(PTRACE_SINGLESTEP, child, NULL, NULL);
  }
  bench_fail_if(child < 0 || kill(child, SIGKILL) != 0 || !within,
                "a kernel cannot be stepped through: ptrace is not allowed here");
  waitpid(child, &status, 0);
}

/* ---- what llvm-mca says -------------------------------------------------------------------- */

/* Comments and the targets of jumps, which llvm-mca does not need, are left out. */
#define INSTRUCTIONS                                                                               \
  "objdump -d --no-show-raw-insn /proc/%ld/exe | awk -F '\\t' '"                                   \
  "NR == FNR { trace[++n] = $1; next } NF == 2 { sub(/ *#.*/, \"\", $2); "                         \
  "sub(/[ ,]+[0-9a-f]+ <.*/, \" 0\", $2); sub(/^(call|ret).*/, \"\", $2); gsub(/[ :]/, \"\", "     \
  "$1); text[$1] = $2 } "                                                                          \
  "END { for (i = 1; i <= n; i++) print trace[i] ~ /LLVM/ ? trace[i] : text[trace[i]] }' %s - | "  \
  "llvm-mca -mcpu=native -iterations=1 -instruction-info=0 -resource-pressure=0"

static void report(const struct measured *measured, size_t count, const char *path) {
  char command[1024], line[256];
  double bound;
  size_t i = 0;
  snprintf(command, sizeof command, INSTRUCTIONS, (long)getpid(), path);
  FILE *said = popen(command, "r");
  while (said != NULL && i < count && fgets(line, sizeof line, said) != NULL) {
    if (sscanf(line, "Block RThroughput: %lf", &bound) == 1) {
      bench_figure(measured[i].cycles, "cycles", "limit.%s.cycles", measured[i].name);
      bench_figure(bound / TRACED, "cycles", "limit.%s.bound", measured[i].name);
      bench_figure(measured[i].cycles * TRACED / bound, "times", "ratio.limit.%s",
                   measured[i].name);
      bench_figure(measured[i].memcpy_cycles, "cycles", "limit.%s.memcpy", measured[i].name);
      i++;
    }
  }
  const bool good = said != NULL && pclose(said) == 0 && i == count;
  unlink(path);
  bench_fail_if(!good,
                "objdump or llvm-mca is missing or does not know this machine: install Debian's "
                "packages binutils and llvm");
}

/* ---- all figures --------------------------------------------------------------------------- */

void bench_limit(void) {
  static struct measured measured[KERNELS * LEVELS];
  char path[] = "/tmp/dipoled-bench-XXXXXX";
  const int file = mkstemp(path);
  FILE *trace = file < 0 ? NULL : fdopen(file, "w");
  bench_fail_if(trace == NULL, "cannot write to /tmp");
  size_t count = 0;
  for (size_t k = 0; k < KERNELS; k++) {
    const core_choice *evaluator = core_choice_by_id(core_evaluators, kernels[k].evaluator);
    const size_t bytes = core_evaluator_bytes(evaluator->id) * RADII;
    bench_contender contenders[2 + LEVELS] = {{.run = run_chain}, {run_memcpy, &bytes, 0}};
    size_t levels = 0;
    bench_fill_radii(bytes / RADII, r, RADII);
    for (size_t i = 0; i < LEVELS; i++) {
      const core_isa *isa = core_isa_select(fused[i]);
      if (isa != NULL) {
        struct measured *one = &measured[count + levels];
        snprintf(one->name, sizeof one->name, "%s.%s.%s",
                 core_choice_by_id(core_models, kernels[k].model)->name, evaluator->name, fused[i]);
        bench_progress(one->name);
        one->profile = bench_profile(isa, kernels[k].model, evaluator->id);
        contenders[1 + ++levels] = (bench_contender){.run = run_kernel, .context = &one->profile};
      }
    }
    bench_compare(contenders, 2 + levels);
    const double cycle_ns = contenders[0].ns / (CHAIN * CYCLES_OF_A_PRODUCT);
    for (size_t i = 1; i <= levels; i++, count++) {
      measured[count].cycles = contenders[1 + i].ns / cycle_ns / RADII;
      measured[count].memcpy_cycles = contenders[1].ns / cycle_ns / RADII;
      fprintf(trace, "// LLVM-MCA-BEGIN\n");
      write_trace(&measured[count].profile, trace);
      fprintf(trace, "// LLVM-MCA-END\n");
      core_profile_free(&measured[count].profile);
    }
  }
  fclose(trace);
  report(measured, count, path);
}
