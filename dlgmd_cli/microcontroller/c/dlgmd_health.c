/* Whether images show what the model needs; see dlgmd_health_us in dlgmd.h. */
#include "dlgmd.h"

#include <string.h>

/* In 1/16 of a grey level, as the sums over 4 x 4 cells are, and in milliseconds. */
enum {
    BLOCKS = DLGMD_BLOCKS,
    COLUMNS = DLGMD_WIDTH / 4,
    LIGHT = 4 * 16,
    CONTRAST = 4 * 16,
    LEVELS = 255 * 16,
    BLIND_MS = 700,
    SOUND_MS = 500,
    SLIGHT_MS = 100
};

void dlgmd_health_reset(dlgmd_sight *sight)
{
    memset(sight, 0, sizeof *sight);
}

static void see(uint16_t *sums, const uint8_t *frame)
{
    for (int i = 0; i < BLOCKS; i++) {
        const uint8_t *row = frame + i / COLUMNS * 4 * DLGMD_WIDTH + i % COLUMNS * 4;
        uint32_t sum = 0;
        for (int y = 0; y < 4; y++, row += DLGMD_WIDTH) {
            sum += (uint32_t)row[0] + row[1] + row[2] + row[3];
        }
        sums[i] = (uint16_t)sum;
    }
}

/* What a share of the blocks is at most: their value in `a`, or how far it is from that in `b`. */
static int32_t quantile(const uint16_t *a, const uint16_t *b, int hundredths)
{
    int rank = BLOCKS * hundredths / 100, low = 0, high = LEVELS;
    while (low < high) {
        int middle = (low + high) / 2, n = 0;
        for (int i = 0; i < BLOCKS; i++) {
            int apart = b == NULL ? a[i] : a[i] < b[i] ? b[i] - a[i] : a[i] - b[i];
            n += apart <= middle;
        }
        if (n > rank) {
            high = middle;
        } else {
            low = middle + 1;
        }
    }
    return low;
}

/* Whether n blocks of two images, or of an image and their neighbours, correlate by less than 0.3. */
static bool is_unlike(const uint16_t *a, const uint16_t *b, int n)
{
    int64_t sum_a = 0, sum_b = 0, aa = 0, bb = 0, ab = 0;
    for (int i = 0; i < n; i++) {
        sum_a += a[i];
        sum_b += b[i];
        aa += (int32_t)a[i] * a[i];
        bb += (int32_t)b[i] * b[i];
        ab += (int32_t)a[i] * b[i];
    }
    aa = n * aa - sum_a * sum_a;
    bb = n * bb - sum_b * sum_b;
    ab = n * ab - sum_a * sum_b;
    for (; (aa | bb) >> 28 != 0; ab /= 2) {
        aa /= 2;
        bb /= 2;
    }
    return aa > 0 && bb > 0 && (ab < 0 || 100 * ab * ab < 9 * aa * bb);
}

/* What is wrong with the newest image, so long after the one before, and since when. */
static dlgmd_blind suspected(dlgmd_sight *sight, uint32_t step_ms, uint32_t *since_ms)
{
    const uint16_t *now = sight->now, *before = sight->before;
    int32_t high = quantile(now, NULL, 90), range = high - quantile(now, NULL, 10);
    bool is_frozen = false, is_noise = false;
    *since_ms = sight->now_ms;
    if (sight->n_seen > 0) {
        /* The usual change is in 1/256. */
        int32_t change = quantile(now, before, 95) * 256;
        int32_t usual = sight->n_seen == 1 ? change : sight->change;
        usual += (change - usual) * 3 / 10;
        sight->change = usual;
        int32_t since = quantile(now, sight->first, 95) * 256;
        int64_t span_ms = step_ms > SLIGHT_MS ? step_ms : SLIGHT_MS;
        is_frozen = 25 * span_ms * usual < 2 * 256 * SLIGHT_MS * (int64_t)range &&
                    2 * since <= 3 * usual + 2 * 4 * 256;
        is_noise = is_unlike(now, before, BLOCKS) && is_unlike(now + 1, now, BLOCKS - 1);
    }
    if (!is_frozen) {
        memcpy(sight->first, now, sizeof sight->first);
        sight->first_ms = sight->now_ms;
    }
    if (high < LIGHT) {
        return DLGMD_BLACK;
    }
    if (range < CONTRAST) {
        return DLGMD_FLAT;
    }
    if (is_noise) {
        return DLGMD_NOISE;
    }
    /* Every image is like the one before; only a long run of them is frozen. */
    if (is_frozen && sight->now_ms - sight->first_ms >= BLIND_MS) {
        *since_ms = sight->first_ms;
        return DLGMD_FROZEN;
    }
    return DLGMD_SOUND;
}

dlgmd_blind dlgmd_health_us(dlgmd_sight *sight, const uint8_t *frame, uint32_t step_us)
{
    uint32_t since_ms;
    bool is_first = sight->n_seen == 0;
    step_us = step_us ? step_us : (1000000 + DLGMD_FPS / 2) / DLGMD_FPS;
    uint32_t step_ms = step_us / 1000;
    sight->rest_us += step_us % 1000;
    step_ms += sight->rest_us / 1000;
    sight->rest_us %= 1000;
    sight->now_ms += is_first ? 0 : step_ms;
    see(sight->now, frame);
    dlgmd_blind now = suspected(sight, step_ms, &since_ms);
    if (is_first || (now == DLGMD_SOUND) != (sight->suspected == DLGMD_SOUND)) {
        sight->turned_ms = since_ms;
    }
    if (is_first || now != sight->suspected) {
        sight->suspected_ms = since_ms;
    }
    sight->suspected = now;
    /* Between two reasons, one image may look like a third. */
    uint32_t from_ms = now && sight->reason ? sight->suspected_ms : sight->turned_ms;
    if (sight->now_ms - from_ms >= (now ? BLIND_MS : SOUND_MS)) {
        sight->reason = now;
    }
    memcpy(sight->before, sight->now, sizeof sight->before);
    sight->n_seen += sight->n_seen < 2;
    return sight->reason;
}
