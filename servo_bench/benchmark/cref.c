/* The reference beside every figure of the bus loop: what this machine grants a C program.
 *
 *     cref PRIORITY CPU START_NS PERIOD_NS CYCLES
 *
 * Sleeps to absolute deadlines on CLOCK_MONOTONIC and skips none, however late it is. Writes
 * CYCLES pairs of 64-bit integers to stdout: deadline in ns, lateness in ns. PRIORITY 0 keeps
 * SCHED_OTHER, CPU -1 keeps the affinity. */
#define _GNU_SOURCE
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <time.h>

#define NS 1000000000LL

int main(int argc, char **argv)
{
    if (argc != 6)
        return 2;
    int priority = atoi(argv[1]), cpu = atoi(argv[2]);
    int64_t start = atoll(argv[3]), period = atoll(argv[4]), cycles = atoll(argv[5]);
    int64_t *rows = calloc((size_t)cycles, 2 * sizeof *rows);
    if (!rows)
        return 3;
    for (int64_t k = 0; k < 2 * cycles; k++)
        rows[k] = k; /* touch every page before the clock matters */
    if (cpu >= 0) {
        cpu_set_t set;
        CPU_ZERO(&set);
        CPU_SET(cpu, &set);
        if (sched_setaffinity(0, sizeof set, &set))
            return 4;
    }
    if (priority > 0) {
        struct sched_param param = {.sched_priority = priority};
        if (sched_setscheduler(0, SCHED_FIFO, &param))
            return 5;
    }
    mlockall(MCL_CURRENT | MCL_FUTURE);
    prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0);
    for (int64_t k = 0; k < cycles; k++) {
        int64_t due = start + k * period;
        struct timespec deadline = {.tv_sec = due / NS, .tv_nsec = due % NS}, now;
        while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &deadline, NULL))
            ;
        clock_gettime(CLOCK_MONOTONIC, &now);
        rows[2 * k] = due;
        rows[2 * k + 1] = now.tv_sec * NS + now.tv_nsec - due;
    }
    return fwrite(rows, 2 * sizeof *rows, (size_t)cycles, stdout) != (size_t)cycles;
}
