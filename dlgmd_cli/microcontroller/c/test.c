/* Compares the answers to frames.gray with those of Python in vectors.h. */
#ifndef ARDUINO /* which compiles every file of a library */
#include "dlgmd.h"

#include <stdio.h>
#include <string.h>

#include "vectors.h"

#define TOLERANCE 1e-5

#ifdef BOARD_TICKS
/* In board.c: a counter of 24 bits that counts down. */
uint32_t board_ticks(void);
#endif

static dlgmd_state state;
static uint8_t frame[DLGMD_HEIGHT * DLGMD_WIDTH];
static dlgmd_answer answers[2][N_FRAMES];
static int n_failed;

static void check(const char *what, bool is_right)
{
    printf("%s: %s\n", what, is_right ? "ok" : "FAILED");
    n_failed += !is_right;
}

static void check_error(const char *what, double error, double most)
{
    printf("%s: within %.2g, at most %.2g allowed: %s\n", what, error, most,
           error <= most ? "ok" : "FAILED");
    n_failed += !(error <= most);
}

static double larger(double a, double b)
{
    return a > b ? a : b;
}

static double apart(double a, double b)
{
    return a > b ? a - b : b - a;
}

/* Process all frames and store the answers; false if the file cannot be read. */
static bool play(dlgmd_answer *into, uint32_t *n_ticks)
{
    FILE *file = fopen("frames.gray", "rb");
    if (file == NULL) {
        return false;
    }
    bool is_whole = true;
    dlgmd_reset(&state);
    *n_ticks = 0;
    for (int i = 0; i < N_FRAMES && is_whole; i++) {
        is_whole = fread(frame, 1, sizeof frame, file) == sizeof frame;
#ifdef BOARD_TICKS
        uint32_t before = board_ticks();
        into[i] = dlgmd_step_us(&state, frame, 0);
        uint32_t ticks = (before - board_ticks()) & 0xffffff;
        *n_ticks = ticks > *n_ticks ? ticks : *n_ticks;
#else
        into[i] = dlgmd_step_us(&state, frame, 0);
#endif
    }
    fclose(file);
    return is_whole;
}

static bool is_same(const dlgmd_answer *a, const dlgmd_answer *b)
{
    return a->valid == b->valid && a->spike == b->spike && a->alarm == b->alarm &&
           !(a->mp < b->mp || a->mp > b->mp) && !(a->g_x < b->g_x || a->g_x > b->g_x) &&
           !(a->expansion_upright < b->expansion_upright ||
             a->expansion_upright > b->expansion_upright) &&
           !(a->expansion < b->expansion || a->expansion > b->expansion);
}

int main(void)
{
    uint32_t n_ticks;
    if (!play(answers[0], &n_ticks) || !play(answers[1], &n_ticks)) {
        puts("frames.gray cannot be read. Run the test in its folder.");
        return 1;
    }
    double mp = 0, mp_abs = 0, place = 0, rate = 0, upright = 0, quality = 0;
    int first[2] = {N_FRAMES, N_FRAMES};
    bool is_valid = true, is_spike = true, is_again = true;
    for (int i = 0; i < N_FRAMES; i++) {
        const dlgmd_answer *answer = &answers[0][i];
        const struct expected *right = &expected[i];
        is_valid = is_valid && answer->valid == right->valid;
        is_spike = is_spike && answer->spike == right->spike;
        is_again = is_again && is_same(answer, &answers[1][i]);
        first[0] = answer->alarm && i < first[0] ? i : first[0];
        first[1] = right->alarm && i < first[1] ? i : first[1];
        /* The error of the centroid is weighted by how much of G is active. */
        double share = right->mp / (right->mp + HALF);
        mp = larger(mp, apart((double)answer->mp, right->mp) / (right->mp + HALF));
        mp_abs = larger(mp_abs, apart((double)answer->mp_abs, right->mp_abs));
        place = larger(place, share * apart((double)answer->g_x, right->g_x));
        place = larger(place, share * apart((double)answer->g_y, right->g_y));
        double error = apart((double)answer->expansion_quality, right->expansion_quality);
        quality = larger(quality, error);
        if (right->expansion_quality >= CLEAR) {
            error = apart((double)answer->expansion, right->expansion);
            rate = larger(rate, error / larger(1, right->expansion));
            error = apart((double)answer->expansion_upright, right->expansion_upright);
            upright = larger(upright, error / larger(1, right->expansion));
        }
    }
    printf("dlgmd, %dx%d, %d frames, %u bytes of state\n", DLGMD_WIDTH, DLGMD_HEIGHT, N_FRAMES,
           (unsigned)sizeof state);
    check("size of the state as the header says", sizeof state == DLGMD_STATE_BYTES);
    check("first answer", is_valid);
    check_error("membrane potential", mp, TOLERANCE);
    check_error("normalised", mp_abs, TOLERANCE);
    check_error("centroid", place, TOLERANCE);
#if DLGMD_EXPANSION
    const double most = 0.15; /* of rates per second where they are precise, relative above 1 */
    check_error("expansion", rate, most);
    check_error("expansion upright", upright, most);
    check_error("quality of the expansion", quality, most);
#endif
    printf("first alarm: frame %d, Python's %d (%d is none)\n", first[0], first[1], N_FRAMES);
    check("spikes", is_spike);
    check("first alarm", first[0] == first[1]);
    check("the same again after a reset", is_again);
#ifdef BOARD_TICKS
    printf("instructions a frame: %lu\n", (unsigned long)n_ticks * BOARD_TICKS);
#endif
    puts(n_failed ? "FAILED" : "passed");
    return n_failed != 0;
}
#endif
