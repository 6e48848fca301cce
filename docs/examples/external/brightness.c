/* A model: tells bright pictures from dark ones by their mean. No dependencies:
 *
 *     cc -O2 -o brightness docs/examples/external/brightness.c
 *
 *     [[model]]
 *     name = "brightness"
 *     kind = "exec"
 *     command = ["./brightness"]
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + (double)t.tv_nsec / 1e9;
}

int main(void)
{
    static char line[8192];
    int parts = 0;
    /* sample BYTES MEDIA-TYPE SHAPE SOURCE, then as many bytes; before it a line "part" for each further part */
    while (fgets(line, sizeof line, stdin)) {
        char word[16], media[128];
        size_t bytes;
        if (sscanf(line, "%15s %zu %127s", word, &bytes, media) != 3) {
            fprintf(stderr, "cannot read %s", line); /* standard error goes to peernet's log */
            return 1;
        }
        unsigned char *picture = malloc(bytes ? bytes : 1);
        if (!picture || fread(picture, 1, bytes, stdin) != bytes)
            return 1;
        if (strcmp(word, "part") == 0) { /* no reply before the last part */
            parts++;
            free(picture);
            continue;
        }
        if (parts > 0) {
            printf("error expected one picture, not a sample of %d parts\n", parts + 1);
        } else if (strcmp(media, "image/x-grey8") != 0 || bytes == 0) {
            printf("error expected grey pixels, not %s\n", media);
        } else {
            double begun = now();
            double sum = 0;
            for (size_t i = 0; i < bytes; i++)
                sum += picture[i];
            double bright = sum / (double)bytes / 255.0;
            double computed = now();
            const char *best = bright >= 0.5 ? "bright" : "dark", *other = bright >= 0.5 ? "dark" : "bright";
            double score = bright >= 0.5 ? bright : 1.0 - bright;
            char answer[256];
            int length = snprintf(answer, sizeof answer,
                "{\"label\":\"%s\",\"score\":%.3f,\"top\":[{\"label\":\"%s\",\"score\":%.3f},"
                "{\"label\":\"%s\",\"score\":%.3f}]}",
                best, score, best, score, other, 1.0 - score);
            printf("stage inference %.9f\n", computed - begun);
            printf("stage postprocessing %.9f\n", now() - computed);
            printf("answer %d application/json\n%s", length, answer);
        }
        fflush(stdout); /* or the answer stays in the buffer */
        free(picture);
        parts = 0;
    }
    return 0;
}
