/* Shows a process the clocks of a host whose oscillator is wrong.
 *
 * This library, preloaded into a process, adds the same error to all clocks that tell time. The error is a function of the
 * machine's true CLOCK_MONOTONIC_RAW. PEERNET_TEST_CLOCK names the file with the schedule of errors, which the test extends
 * while the process runs. clock_shim/mod.rs has the same layout and the same formula. */
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

/* Error from `begin` until the next segment begins. At `begin` the clocks are ahead by `ahead` nanoseconds and run fast by
 * `rate`, which grows by `rate_change` per nanosecond. */
struct segment {
    int64_t begin;
    int64_t ahead;
    double rate;
    double rate_change;
};

struct schedule {
    _Atomic uint64_t count;
    struct segment segments[SEGMENTS];
};

static const struct schedule *schedule;
static int (*real_clock_gettime)(clockid_t, struct timespec *);

static int64_t error_at(int64_t raw)
{
    uint64_t begun = atomic_load_explicit(&schedule->count, memory_order_acquire);
    while (begun > 0 && schedule->segments[begun - 1].begin > raw)
        begun--;
    if (begun == 0)
        return 0;
    const struct segment *segment = &schedule->segments[begun - 1];
    double elapsed = (double)(raw - segment->begin);
    return segment->ahead + llround(elapsed * (segment->rate + segment->rate_change * elapsed / 2));
}

__attribute__((constructor)) static void map_schedule(void)
{
    real_clock_gettime = (int (*)(clockid_t, struct timespec *))dlsym(RTLD_NEXT, "clock_gettime");
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
    if (!real_clock_gettime)
        real_clock_gettime = (int (*)(clockid_t, struct timespec *))dlsym(RTLD_NEXT, "clock_gettime");
    int failed = real_clock_gettime(clock, time);
    if (failed || !schedule || !tells_time(clock))
        return failed;
    struct timespec raw = *time;
    if (clock != CLOCK_MONOTONIC_RAW)
        real_clock_gettime(CLOCK_MONOTONIC_RAW, &raw);
    int64_t error = error_at(raw.tv_sec * SECOND + raw.tv_nsec);
    int64_t shown = time->tv_sec * SECOND + time->tv_nsec + error;
    time->tv_sec = shown / SECOND;
    time->tv_nsec = shown % SECOND;
    return 0;
}
