// Live charts of pipelines: stages stacked over the last minutes, the 95th percentile above, throughputs below.
// Means of seconds are combined to means of buckets here. The aggregator splits totals into parts. It also computes the percentiles, because
// a mean of percentiles is not a percentile.
(() => {
  const MAX_SECONDS = 600, RETRY_MS = 2000;
  // Longest time between two reports of a connected host, which reports every five seconds.
  const MAX_REPORT_GAP_S = 15;
  // Largest decrease of a host's clock that removes no seconds; the aggregator has the same limit.
  const MAX_CLOCK_DECREASE_S = 2;
  // Minimum time between two drawings of new data, milliseconds. In this time only the newest bucket changes, by too
  // little to be visible.
  const MIN_REDRAW_MS = 1000;
  let cards = [], range = 600, isolatedStage = null, paused = false, marks = [], scale = { max: 0, since: 0 }, queued = 0, drawnAt = 0;

  function begin() {
    PEER.forget();
    const block = document.getElementById("data");
    if (!block || !document.querySelector(".live-chart")) return;
    const data = JSON.parse(block.textContent);
    marks = data.marks;
    // `n` has the number of successful iterations of each second since `from`, and `null` for a second without a report.
    cards = data.charts.map((card) => ({ ...card, last: card.from + card.n.length - 1 }));
    scale = { max: 0, since: 0 };
    for (const card of cards) {
      const node = document.querySelector(`.live-chart[data-key="${CSS.escape(card.key)}"]`);
      if (!node || node.drawing) continue;
      card.drawing = PEER.draw(node, () => options(card, node));
      card.drawing.chart.group = "live";
    }
    echarts.connect("live");
  }

  // --- seconds into buckets
  function grow(list, length) { while (list.length < length) list.push(null); }
  // Returns the lists of a card that have an entry for each second since `from`.
  const lists = (card) => [card.n, ...Object.values(card.means), ...Object.values(card.transfers)];
  // Prepares a card for a report whose newest second is `at`. If the host's clock was set, seconds that the clock shows again and seconds
  // outside the chart are removed, as the aggregator removes them.
  function follow(card, at) {
    if (at !== card.last) card.reportedAt = performance.now();
    if (card.n.length === 0) return;
    if (at - card.last >= MAX_SECONDS || at < card.from) {
      for (const list of lists(card)) list.length = 0;
      card.from = at - MAX_SECONDS + 1;
      grow(card.n, MAX_SECONDS);
    } else if (card.last - at > MAX_CLOCK_DECREASE_S) {
      for (const list of lists(card)) list.length = Math.min(list.length, at - card.from + 1);
    } else return;
    state++;
    card.last = at;
    card.p95.points = card.p95.points.filter(([start]) => start <= at);
  }
  // Adds the values of a second to a card. A second may be received again.
  function put(card, second) {
    state++;
    let at = second.at - card.from;
    if (card.n.length === 0) { card.from = second.at; at = 0; }
    if (at < 0 || at >= card.n.length + MAX_SECONDS) return;
    const length = at + 1;
    grow(card.n, length);
    card.n[at] = second.counts.ok;
    for (const [name, value] of Object.entries({ ...second.parts, total: second.means.total })) {
      if (value == null) continue;
      const list = (card.means[name] ||= []);
      grow(list, length);
      list[at] = value * 1e3;
    }
    for (const list of Object.values(card.means)) { grow(list, length); list[at] ??= null; }
    for (const [direction, sent] of [["up", second.transfers.upload], ["down", second.transfers.download]]) {
      grow(card.transfers[direction], length);
      card.transfers[direction][at] = sent?.timed_bytes > 0 && sent.seconds > 0 ? [sent.timed_bytes, sent.seconds * 1e6] : null;
    }
    const extra = card.n.length - MAX_SECONDS;
    if (extra > 0) {
      card.from += extra;
      for (const list of lists(card)) list.splice(0, extra);
    }
    card.last = card.from + card.n.length - 1;
  }

  // Stores received percentiles; `complete` is true if they are all percentiles of the card. Returns false if older
  // percentiles are missing, because the buckets have another length than before.
  function putPercentiles(card, { bucket_s: size, points }, complete) {
    state++;
    const isSameLength = size === card.p95.size, fresh = points.map(({ at, p95 }) => [at, p95 * 1e3]), times = new Set(points.map(({ at }) => at));
    const kept = complete || !isSameLength ? [] : card.p95.points.filter(([at]) => !times.has(at) && at + size > card.from);
    card.p95 = { size, points: kept.concat(fresh).sort((one, other) => one[0] - other[0]) };
    return complete || isSameLength;
  }
  // Returns the percentiles within the range as (start, end, ms); none if the range is shorter than one bucket.
  function percentiles(card, start, end) {
    const { size, points } = card.p95;
    if (!size || size > end - start) return [];
    return points.filter(([at]) => at < end && at + size > start).map(([at, value]) => [Math.max(at, start) * 1e3, Math.min(at + size, end) * 1e3, value]);
  }

  // Returns the newest second of all cards, at which charts end. The clocks of some hosts may be wrong; the chart of a host that
  // reports shows the host's time, so cards that are too far from it do not count.
  function newestSecond(card) {
    const reports = performance.now() - (card.reportedAt ?? -Infinity) < MAX_REPORT_GAP_S * 1000;
    return Math.max(...cards.map((other) => other.last).filter((last) => !reports || Math.abs(last - card.last) < MAX_SECONDS));
  }
  // Returns the buckets of a card. They are cached until any card changes, because a chart ends at the newest second of other cards, too.
  // `state` counts the changes.
  let state = 0;
  function bucketed(card) {
    const key = `${state} ${range}`;
    if (card.view?.key !== key) card.view = { key, ...buckets(card) };
    return card.view;
  }
  function buckets(card) {
    const end = newestSecond(card) + 1, start = end - range;
    const known = card.n.filter((count) => count != null), rate = known.reduce((sum, count) => sum + count, 0) / Math.max(1, known.length);
    const size = PEER.bucket(range, rate);
    const stages = PEER.PARTS.filter((part) => card.means[part]);
    const rows = [];
    for (let from = Math.floor(start / size) * size; from < end; from += size) {
      const row = { at: (from + size / 2) * 1e3, n: 0, reported: false, means: {}, total: null };
      const seconds = [];
      for (let at = Math.max(from, card.from); at < from + size && at <= card.last; at++) {
        const index = at - card.from;
        if (card.n[index] == null) continue;
        row.reported = true;
        if (card.n[index] > 0) { seconds.push(index); row.n += card.n[index]; }
      }
      // Equals `mean_of_groups` of stage_split.rs, which makes the table of the chart.
      const mean = (list) => {
        let sum = 0, hasValue = false;
        for (const index of seconds) if (list?.[index] != null) { sum += list[index] * card.n[index]; hasValue = true; }
        return hasValue ? sum / row.n : null;
      };
      // Speed is bytes divided by transfer time, as in `Transfer::speed` of transfer.rs; bytes per microsecond are MB/s.
      const speed = (list) => {
        let bytes = 0, time = 0;
        for (const index of seconds) if (list[index]) { bytes += list[index][0]; time += list[index][1]; }
        return time > 0 ? bytes / time : null;
      };
      if (row.n > 0) {
        row.total = mean(card.means.total);
        for (const stage of stages) row.means[stage] = mean(card.means[stage]) ?? 0;
        row.up = speed(card.transfers.up);
        row.down = speed(card.transfers.down);
      }
      rows.push(row);
    }
    return { rows, size, p95: percentiles(card, start, end), stages, start: start * 1e3, end: end * 1e3 };
  }

  // Returns the gaps: at least three seconds without a report, between seconds with a report.
  function gaps(card) {
    const found = [];
    let gapStart = null;
    card.n.forEach((count, index) => {
      if (count == null) { gapStart ??= index; return; }
      if (gapStart != null && gapStart > 0 && index - gapStart >= 3) found.push({ from: (card.from + gapStart) * 1e3, to: (card.from + index) * 1e3, text: "no report" });
      gapStart = null;
    });
    return found;
  }

  // Returns one scale for all charts, so that they can be compared. It grows at once. It shrinks after half a minute in
  // which a smaller scale was enough.
  function sharedScale() {
    let highest = 0;
    for (const card of cards) {
      const { rows, p95 } = bucketed(card);
      for (const row of rows) {
        const value = isolatedStage ? PEER.PARTS.filter((stage) => PEER.look(stage) === isolatedStage).reduce((sum, stage) => sum + (row.means[stage] || 0), 0) : row.total || 0;
        highest = Math.max(highest, value);
      }
      if (!isolatedStage) for (const [, , value] of p95) highest = Math.max(highest, value);
    }
    const wanted = PEER.steps(highest), now = performance.now();
    if (wanted.max >= scale.max || now - scale.since > 30000) scale = { ...wanted, since: now };
    return { max: scale.max, interval: scale.interval };
  }

  // The line is interrupted while the host was disconnected.
  function withGaps(list) {
    const points = [];
    list.forEach(([at, value], index) => {
      if (index > 0 && at - list[index - 1][0] > MAX_REPORT_GAP_S) points.push([list[index - 1][0] * 1e3 + 1, null]);
      points.push([at * 1e3, value]);
    });
    return points;
  }

  // A single point between gaps is no visible line, so it is drawn as a dot.
  function withDots(points) {
    const isNone = (point) => point?.[1] == null;
    return points.map((point, index) => (!isNone(point) && isNone(points[index - 1]) && isNone(points[index + 1]) ? { value: point, symbol: "circle", symbolSize: PEER.px(0.3125) } : point));
  }

  // Each percentile is a horizontal line as long as its bucket. Buckets without a percentile interrupt the line.
  function percentileLines(p95) {
    const points = [];
    p95.forEach(([from, to, value], index) => {
      if (index > 0 && p95[index - 1][1] < from) points.push([p95[index - 1][1], null]);
      points.push([from, value], [to, value]);
    });
    return points;
  }

  // Returns the points of the area of a stage. The area of a single bucket between empty buckets is as wide as the
  // bucket, and ends just before the next bucket. Otherwise it would have no width.
  function areas(rows, stage, size) {
    const points = [];
    rows.forEach((row, index) => {
      const value = row.n > 0 ? row.means[stage] : null;
      if (row.n > 0 && !(rows[index - 1]?.n > 0) && !(rows[index + 1]?.n > 0)) points.push([row.at - size * 500, value], [row.at + size * 499, value]);
      else points.push([row.at, value]);
    });
    return points;
  }

  // Returns the low plots below the main plot: the throughputs of a pipeline that sends messages, otherwise the load of
  // CPU and GPU. An obstacle is the reason why a direction has no throughput.
  function strips(card, rows) {
    const points = (key) => rows.map((row) => [row.at, row[key] ?? null]);
    if (card.remote) {
      const strip = (key, color, why) => (why ? { name: `${key}: ${why}`, color, points: [], known: false } : { name: `${key} while sending, MB/s`, color, points: points(key), known: true });
      return [strip("up", "--s-upload", card.obstacles[0]), strip("down", "--s-download", card.obstacles[1])];
    }
    const host = (list, name) => ({ name: list.length ? `${name} of ${card.host}, %` : `${name} of ${card.host}: not readable`, color: "--ink-2", points: withGaps(list), known: list.length > 0, max: 100 });
    return [host(card.cpu, "CPU"), host(card.gpu, "GPU")].filter((strip, index) => index === 0 || strip.known);
  }

  function options(card, node) {
    const { rows, size, p95, stages, start, end } = bucketed(card);
    const timePrecision = range <= 60, valueScale = sharedScale(), below = strips(card, rows);
    for (const strip of below) strip.max ??= PEER.steps(strip.points.reduce((most, point) => Math.max(most, point[1] || 0), 0)).max;
    const { left, right } = PEER.sides(PEER.ticks(valueScale).concat(below.map((strip) => NUMBERS.tick(strip.max))), timePrecision);
    const main = { left, right, top: PEER.px(2.25), height: PEER.px(below.length > 1 ? 9.25 : 11.5) };
    const tops = below.map((_, index) => main.top + main.height + PEER.px(1.1 + index * 2.25)), low = PEER.px(1.1);
    const plots = [[main.top, main.top + main.height], ...tops.map((top) => [top, top + low])];
    const shown = isolatedStage ? stages.filter((stage) => PEER.look(stage) === isolatedStage) : stages;
    const axes = { min: start, max: end };
    const series = shown.map((stage) => ({
      name: stage, type: "line", stack: "stages", symbol: "none", data: areas(rows, stage, size),
      lineStyle: { width: 0 }, areaStyle: { color: PEER.fill(stage), opacity: 1 }, emphasis: { disabled: true }, z: 2,
    }));
    if (!isolatedStage) series.push({ name: "p95", type: "line", symbol: "none", data: percentileLines(p95), lineStyle: { width: 1.25, color: PEER.css("--ink") }, emphasis: { disabled: true }, z: 5 });
    // The name contains `known`, so that `redraw` replaces all options when `known` changes.
    below.forEach((strip, index) => series.push({ name: `strip ${index} ${strip.known}`, type: "line", symbol: "none", xAxisIndex: index + 1, yAxisIndex: index + 1, data: withDots(strip.points), lineStyle: { width: 1.25, color: PEER.css(strip.color) }, itemStyle: { color: PEER.css(strip.color) }, emphasis: { disabled: true }, z: 3 }));
    const cardMarks = marks.filter((mark) => mark.host === card.host && (!mark.pipeline || mark.pipeline === card.pipeline) && mark.at >= start);
    series.push(PEER.marks(cardMarks, gaps(card), plots));
    return {
      grid: [main, ...tops.map((top) => ({ left, right, top, height: low }))],
      axisPointer: { link: [{ xAxisIndex: "all" }] },
      tooltip: PEER.tooltip((params) => {
        if (!PEER.isHovered(node) || !params.length) return "";
        const row = rows.reduce((best, other) => (Math.abs(other.at - params[0].axisValue) < Math.abs(best.at - params[0].axisValue) ? other : best), rows[0]);
        const lines = shown.slice().reverse().filter((stage) => row.n > 0).map((stage) => ({ stage, name: stage, value: NUMBERS.milliseconds(row.means[stage]) }));
        const percentile = p95.find(([from, to]) => row.at >= from && row.at < to);
        lines.push({ name: "total, mean", value: NUMBERS.milliseconds(row.total), sum: true }, { name: card.p95.size ? `p95 of ${card.p95.size} s` : "p95", value: NUMBERS.milliseconds(percentile?.[2]) });
        if (card.remote) lines.push({ name: "up while sending, MB/s", value: NUMBERS.throughput(row.up), sum: true }, { name: "down while sending, MB/s", value: NUMBERS.throughput(row.down) });
        return PEER.tip(PEER.timeOfDay(row.at - size * 500, true), size === 1 ? "ms, mean of 1 s" : `ms, mean of ${size} s`, lines);
      }),
      xAxis: [0, ...below.map((_, index) => index + 1)].map((grid) => PEER.timeAxis({ ...axes, gridIndex: grid, ...(grid < below.length ? { axisLabel: { show: false } } : {}), timePrecision, splitNumber: 4 })),
      yAxis: [
        PEER.valueAxis("ms", { ...valueScale, axisLabel: { ...PEER.text(), margin: PEER.px(0.375), formatter: NUMBERS.tick } }),
        ...below.map(({ name, max, known }, index) => PEER.valueAxis(name, {
          gridIndex: index + 1, max, interval: max, splitLine: { show: false }, nameGap: PEER.px(0.2), nameTextStyle: { ...PEER.text(), align: "left" },
          axisLabel: { ...PEER.text(), margin: PEER.px(0.375), show: known, formatter: (value) => (value === 0 ? "" : NUMBERS.tick(value)) },
        })),
      ],
      series,
    };
  }

  // Draws at once after an action of the user, and at most once per MIN_REDRAW_MS for new data.
  function refresh() {
    clearTimeout(queued);
    queued = 0;
    if (paused || document.hidden) return;
    drawnAt = performance.now();
    requestAnimationFrame(() => cards.forEach((card) => card.drawing && PEER.redraw(card.drawing)));
  }
  function scheduleRefresh() {
    if (queued || paused || document.hidden) return;
    // Until a bucket ends, only the newest bucket changes, so a drawing per bucket is enough.
    const pace = Math.max(MIN_REDRAW_MS, ...cards.map((card) => (card.view?.size ?? 0) * 1000));
    queued = setTimeout(refresh, Math.max(0, pace - (performance.now() - drawnAt)));
  }

  // --- new data
  document.addEventListener("peernet-picture", ({ detail }) => {
    for (const pipeline of detail.pipelines) {
      const card = cards.find((other) => other.host === pipeline.host && other.pipeline === pipeline.name);
      if (!card) continue;
      const oldest = pipeline.seconds[0], newest = pipeline.seconds[pipeline.seconds.length - 1];
      const misses = oldest && card.n.length && oldest.at > card.last + 1;
      if (newest) follow(card, newest.at);
      if (card.hasMissedSeconds || misses) catchUp(card);
      pipeline.seconds.forEach((second) => put(card, second));
      if (!putPercentiles(card, pipeline.total_over_time, false)) catchUp(card);
      const host = detail.hosts.find((other) => other.name === card.host), at = Math.floor(Date.parse(detail.at) / 1000);
      for (const name of ["cpu", "gpu"]) {
        const list = card[name];
        // Later points are from before the aggregator's clock was set back.
        while (list.length && list[list.length - 1][0] > at) list.pop();
        // Like the history from the server, the list has a point every five seconds.
        if (card.remote || !host?.connected || host[name] == null || (list.length && at - list[list.length - 1][0] < 5)) continue;
        list.push([at, host[name] * 100]);
        if (list.length > MAX_SECONDS / 5) list.shift();
      }
    }
    scheduleRefresh();
  });
  // Fetches the seconds that this page missed. Seconds that were never reported remain a gap.
  async function catchUp(card) {
    card.hasMissedSeconds = true;
    if (performance.now() - (card.requestedAt ?? -RETRY_MS) < RETRY_MS) return;
    card.requestedAt = performance.now();
    try {
      const answer = await fetch(`/api/v1/pipelines/${encodeURIComponent(card.host)}/${encodeURIComponent(card.pipeline)}`);
      if (!answer.ok) throw new Error(`status ${answer.status}`);
      const pipeline = await answer.json();
      const newest = pipeline.seconds[pipeline.seconds.length - 1];
      // The answer may be older than the card.
      if (newest?.at > card.last) follow(card, newest.at);
      pipeline.seconds.forEach((second) => put(card, second));
      putPercentiles(card, pipeline.total_over_time, true);
      card.hasMissedSeconds = false;
      refresh();
    } catch { /* The next update requests the seconds again. */ }
  }
  document.addEventListener("peernet-reconnected", () => cards.forEach(catchUp));
  document.addEventListener("peernet-updated", ({ detail }) => {
    if (detail.marks.length) marks = detail.marks;
    for (const [key, obstacles] of detail.obstacles) {
      const card = cards.find((other) => other.key === key);
      if (card) card.obstacles = obstacles;
    }
  });
  document.addEventListener("peernet-pause", ({ detail }) => { paused = detail; refresh(); });
  document.addEventListener("visibilitychange", refresh);
  document.addEventListener("peernet-range", ({ detail }) => { range = detail; scale = { max: 0, since: 0 }; refresh(); });
  document.addEventListener("peernet-isolate", ({ detail }) => { isolatedStage = detail; scale = { max: 0, since: 0 }; refresh(); });
  document.addEventListener("peernet-reloaded", begin);
  begin();
})();
