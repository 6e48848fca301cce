/* Shows a process the clocks of a host whose oscillator is wrong.
 *
 * Preloaded into a process, it adds one error to all clocks that tell time: the error at a moment of the machine's true
 * CLOCK_MONOTONIC_RAW. The schedule of errors is a file that PEERNET_TEST_CLOCK names and that the test extends while the process
 * runs; clock_shim/mod.rs has the same layout and the same formula. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <math.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#define SECOND 1000000000LL
#define SEGMENTS 255

/* From `begin` until the next segment begins: ahead by `ahead` ns, then fast by `rate`, which grows by `change` per nanosecond. */
struct segment {
    int64_t begin;
    int64_t ahead;
    double rate;
    double change;
};

struct schedule {
    _Atomic uint64_t count;
    struct segment segments[SEGMENTS];
};

static const struct schedule *schedule;
static int (*real)(clockid_t, struct timespec *);

static int64_t ahead(int64_t raw)
{
    uint64_t at = atomic_load_explicit(&schedule->count, memory_order_acquire);
    while (at > 0 && schedule->segments[at - 1].begin > raw)
        at--;
    if (at == 0)
        return 0;
    const struct segment *segment = &schedule->segments[at - 1];
    double elapsed = (double)(raw - segment->begin);
    return segment->ahead + llround(elapsed * (segment->rate + segment->change * elapsed / 2));
}

__attribute__((constructor)) static void begin(void)
{
    real = (int (*)(clockid_t, struct timespec *))dlsym(RTLD_NEXT, "clock_gettime");
    const char *path = getenv("PEERNET_TEST_CLOCK");
    int file = path ? open(path, O_RDONLY | O_CLOEXEC) : -1;
    void *mapped = file < 0 ? MAP_FAILED : mmap(NULL, sizeof *schedule, PROT_READ, MAP_SHARED, file, 0);
    if (file >= 0)
        close(file);
    if (mapped == MAP_FAILED) {
        perror("cannot read the schedule that PEERNET_TEST_CLOCK names");
        _exit(70);
    }
    schedule = mapped;
}

static int tells_time(clockid_t clock)
{
    return clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE || clock == CLOCK_MONOTONIC
        || clock == CLOCK_MONOTONIC_COARSE || clock == CLOCK_MONOTONIC_RAW || clock == CLOCK_BOOTTIME;
}

int clock_gettime(clockid_t clock, struct timespec *time)
{
    if (!real)
        real = (int (*)(clockid_t, struct timespec *))dlsym(RTLD_NEXT, "clock_gettime");
    int failed = real(clock, time);
    if (failed || !schedule || !tells_time(clock))
        return failed;
    struct timespec raw = *time;
    if (clock != CLOCK_MONOTONIC_RAW)
        real(CLOCK_MONOTONIC_RAW, &raw);
    int64_t error = ahead(raw.tv_sec * SECOND + raw.tv_nsec);
    int64_t shown = time->tv_sec * SECOND + time->tv_nsec + error;
    time->tv_sec = shown / SECOND;
    time->tv_nsec = shown % SECOND;
    return 0;
}
