// Functions that all charts share: colours of app.css, axes, tooltips, gaps and marks. Charts are redrawn when the theme changes.
const PEER = (() => {
  // Parts of a total in the order of every stack: stages, both directions together, the unattributed time. The server sets the attribute:
  // of each part its name, the class of its colour, and `edge` if its area is too pale for a line, which then has the darker colour of the edge.
  const looks = document.documentElement.dataset.parts.split(",").map((part) => part.split(":"));
  const PARTS = looks.map(([name]) => name), CLASSES = new Map(looks);
  const EDGED = new Set(looks.filter(([, , edge]) => edge).map(([, name]) => name));
  const drawn = new Set();
  // Hidden element, by which the browser computes colours.
  let probe = null;

  // Values of the style sheets, cached until the theme or the size changes: reading them makes the browser compute styles.
  const cache = new Map();
  function cached(key, read) {
    if (!cache.has(key)) cache.set(key, read());
    return cache.get(key);
  }
  // These listeners are registered, and therefore run, before the listeners that redraw the charts. The charts
  // therefore read the new values.
  document.addEventListener("peernet-theme", () => cache.clear());
  addEventListener("resize", () => cache.clear());

  // The browser resolves light-dark() in a computed colour.
  const css = (name) => cached(name, () => {
    if (!probe || !probe.isConnected) { probe = document.createElement("i"); probe.hidden = true; document.body.appendChild(probe); }
    probe.style.color = `var(${name})`;
    return getComputedStyle(probe).color;
  });
  const px = (rem) => rem * cached("rem", () => parseFloat(getComputedStyle(document.documentElement).fontSize));
  // Returns the class of the colour of a stage, which may also be given as a class.
  const look = (stage) => CLASSES.get(stage) ?? stage;

  // Returns a hatched fill. Its lines rise to the right if `angle` is positive, else they fall.
  function hatch(ground, line, angle) {
    const canvas = document.createElement("canvas"), ratio = window.devicePixelRatio || 1, size = 6;
    canvas.width = canvas.height = size * ratio;
    const pen = canvas.getContext("2d");
    pen.scale(ratio, ratio);
    if (ground) { pen.fillStyle = ground; pen.fillRect(0, 0, size, size); }
    pen.strokeStyle = line;
    pen.lineWidth = 1.3;
    for (const at of [-size, 0, size]) {
      pen.beginPath();
      if (angle > 0) { pen.moveTo(at, size); pen.lineTo(at + size, 0); } else { pen.moveTo(at, 0); pen.lineTo(at + size, size); }
      pen.stroke();
    }
    return { image: canvas, repeat: "repeat", scaleX: 1 / ratio, scaleY: 1 / ratio };
  }
  // Returns the fill for both directions together: narrow rows in the colours of both directions.
  function both(up, down) {
    const canvas = document.createElement("canvas");
    canvas.width = 1;
    canvas.height = 8;
    const pen = canvas.getContext("2d");
    pen.fillStyle = up;
    pen.fillRect(0, 0, 1, 6);
    pen.fillStyle = down;
    pen.fillRect(0, 6, 1, 2);
    return { image: canvas, repeat: "repeat" };
  }
  const fill = (stage) => cached(`fill ${stage}`, () => {
    if (look(stage) === "queue") return hatch(css("--s-queue"), css("--e-queue"), 1);
    if (look(stage) === "network") return both(css("--s-upload"), css("--s-download"));
    if (look(stage) === "unattributed") return hatch(css("--s-unattributed"), css("--e-unattributed"), -1);
    return css(`--s-${look(stage)}`);
  });
  // Returns the colour of lines and points of a stage.
  const lineColour = (stage) => (look(stage) === "network" ? css("--s-upload") : css((EDGED.has(look(stage)) ? "--e-" : "--s-") + look(stage)));

  const offset = () => Number(document.documentElement.dataset.offset) * 1000;
  // Formats a time of day: to the minute; to the second if `precision` is true; to the millisecond if it is "ms".
  const timeOfDay = (time, precision) => new Date(time + offset()).toISOString().slice(11, precision === "ms" ? 23 : precision ? 19 : 16);
  const FONT = "Inter, system-ui, sans-serif";
  const text = () => ({ color: css("--ink-3"), fontSize: px(0.6875), fontFamily: FONT });
  // Returns the width of the widest of some labels.
  const ruler = document.createElement("canvas").getContext("2d");
  function maxLabelWidth(labels) {
    const { fontSize, fontFamily } = text();
    ruler.font = `${fontSize}px ${fontFamily}`;
    return Math.ceil(Math.max(0, ...labels.map((label) => ruler.measureText(label).width)));
  }
  // Margins of a plot: on the left for the labels of its values, on the right for half a label of the time axis.
  const sides = (values, timePrecision) => ({ left: Math.max(px(2.25), px(0.375) + maxLabelWidth(values)), right: maxLabelWidth([timeOfDay(0, timePrecision)]) / 2 });
  function timeAxis(more) {
    return {
      type: "time", axisLine: { lineStyle: { color: css("--line") } }, axisTick: { show: false }, splitLine: { show: false },
      axisLabel: { ...text(), hideOverlap: true, showMinLabel: false, showMaxLabel: false, formatter: (time) => timeOfDay(time, more?.timePrecision), ...more?.ends },
      axisPointer: { lineStyle: { color: css("--ink-3"), width: 1, type: "solid" }, label: { show: false } },
      ...more,
    };
  }
  function valueAxis(unit, more) {
    return {
      type: "value", min: 0, name: unit, nameLocation: "end", nameGap: px(0.75),
      nameTextStyle: { ...text(), align: "right", padding: [0, px(0.375), 0, 0] },
      axisLine: { show: false }, axisTick: { show: false }, splitLine: { lineStyle: { color: css("--line"), width: 1 } },
      axisLabel: { ...text(), margin: px(0.375) }, splitNumber: 4, axisPointer: { show: false },
      ...more,
    };
  }
  function tooltip(formatter) {
    return {
      trigger: "axis", confine: false, transitionDuration: 0, backgroundColor: css("--surface"), borderColor: css("--line-strong"), borderWidth: 1,
      padding: [px(0.5), px(0.75)], extraCssText: "box-shadow:none;border-radius:6px;z-index:4",
      axisPointer: { type: "line", lineStyle: { color: css("--ink-3"), width: 1, type: "solid" } },
      // The tooltip opens below the plot, so that it never covers the data.
      position: (point, _params, _node, _rect, size) => [Math.max(0, Math.min(size.viewSize[0] - size.contentSize[0], point[0] - size.contentSize[0] / 2)), size.viewSize[1] - px(0.25)],
      formatter,
    };
  }

  // --- tooltips are nodes with classes, because the content security policy forbids inline styles
  function element(tag, name, content) {
    const node = document.createElement(tag);
    if (name) node.className = name;
    if (content != null) node.textContent = content;
    return node;
  }
  function swatch(stage) {
    const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
    const rect = document.createElementNS("http://www.w3.org/2000/svg", "rect");
    svg.setAttribute("class", "swatch");
    rect.setAttribute("class", `f-${look(stage)}`);
    svg.appendChild(rect);
    return svg;
  }
  function tip(title, right, rows) {
    const box = element("div", "tip"), head = element("div", "t");
    head.append(element("span", "", title), element("span", "", right || ""));
    box.append(head);
    for (const row of rows) {
      const line = element("div", `r${row.sum ? " sum" : ""}`);
      line.append(row.stage ? swatch(row.stage) : element("span"), element("span", "", row.name), element("b", "", row.value));
      box.append(line);
    }
    return box;
  }

  // --- marks on the time axis: a dashed line across the plot with a sign above it; a gap is a hatched span
  // Returns the path of an icon of the page. The path lies in a square of 12 × 12 units.
  const iconPath = (name) => document.querySelector(`#i-${name} path`).getAttribute("d");
  // Gaps that are closer than this, px, are drawn as one, and so are crosses of failed iterations.
  const TOUCHING = 6;
  // Returns the visible gaps in pixels. Neighbours closer than TOUCHING px are merged. If `commonText` is given, it is
  // the text of the widest gap, and the other gaps have no text.
  function spans(gaps, api, area, commonText) {
    const found = [];
    gaps.forEach((gap, index) => {
      const from = Math.max(api.coord([gap.from, 0])[0], area.x), to = Math.min(api.coord([gap.to, 0])[0], area.x + area.width);
      if (to < area.x || from > area.x + area.width) return;
      const last = found[found.length - 1];
      if (last && from - last.to < TOUCHING) last.to = Math.max(last.to, to);
      else found.push({ index, from, to, text: gap.text });
    });
    const widest = found.reduce((best, span) => (best && best.to - best.from >= span.to - span.from ? best : span), null);
    // The text of a short gap could overlap a sign, so short gaps have no text. A single gap always has its text.
    for (const span of found) span.shownText = commonText ? (span === widest ? commonText : "") : span.to - span.from >= px(0.75) || gaps.length === 1 ? span.text : "";
    return new Map(found.map((span) => [span.index, span]));
  }
  function marks(list, gaps, plots, commonText) {
    const faint = css("--ink-3"), ink = css("--ink-2"), shade = cached("shade", () => hatch(null, css("--line"), 1)), words = text();
    const rows = gaps.map((gap) => [gap.from, gap.to, "gap-span"]).concat(list.map((mark) => [mark.at, mark.at, mark.sign]));
    return {
      type: "custom", silent: true, z: 6, clip: false, tooltip: { show: false }, encode: { x: [0, 1] }, data: rows.map((row) => [row[0], row[1]]),
      renderItem(params, api) {
        const kind = rows[params.dataIndex][2], area = params.coordSys, unit = px(0.75) / 12;
        const dash = (x) => plots.map(([top, bottom]) => ({ type: "line", shape: { x1: x, x2: x, y1: top, y2: bottom }, style: { stroke: faint, lineWidth: 1, lineDash: [2, 3] } }));
        if (kind === "gap-span") {
          params.context.spans ??= spans(gaps, api, area, commonText);
          const span = params.context.spans.get(params.dataIndex);
          if (!span) return null;
          const { from, to, shownText: note } = span;
          // With one text for all gaps, narrow gaps are bands without edges, because edges alone would look like marks.
          const band = Boolean(commonText) && to - from < px(0.75);
          const style = band ? { fill: css("--line-strong"), opacity: 0.35 } : { fill: shade };
          const shades = plots.map(([top, bottom]) => ({ type: "rect", shape: { x: from, y: top, width: Math.max(to - from, 2), height: bottom - top }, style }));
          const label = { type: "text", style: { text: note, x: Math.max(area.x + px(2), Math.min(area.x + area.width - px(2.25), (from + to) / 2)), y: plots[0][0] - px(0.25), align: "center", verticalAlign: "bottom", fill: ink, fontSize: words.fontSize, fontFamily: FONT } };
          return { type: "group", children: shades.concat(band ? [] : dash(from), band ? [] : dash(to), note ? [label] : []) };
        }
        const from = api.coord([api.value(0), 0])[0];
        if (from < area.x || from > area.x + area.width) return null;
        const sign = { type: "path", x: from - 6 * unit, y: plots[0][0] - 14 * unit, scaleX: unit, scaleY: unit, shape: { pathData: iconPath(kind) }, style: { fill: "none", stroke: ink, lineWidth: 1.3, strokeNoScale: true } };
        return { type: "group", children: dash(from).concat([sign]) };
      },
    };
  }

  // Draws periods of warm-up as shades, borders of episodes as dashed lines, and failed iterations as crosses above the plot.
  function runMarks({ borders, warmUp, failed }, [top, bottom]) {
    const rows = warmUp.map((period) => [...period, "warm-up"]).concat(borders.map((at) => [at, at, "border"]), failed.map((at) => [at, at, "cross"]));
    const ink = css("--ink"), bad = css("--bad"), size = px(0.5) / 12;
    return {
      type: "custom", name: "run-marks", silent: true, z: 1, clip: false, tooltip: { show: false }, encode: { x: [0, 1] }, data: rows.map((row) => [row[0], row[1]]),
      renderItem(params, api) {
        const kind = rows[params.dataIndex][2], area = params.coordSys, end = area.x + area.width;
        const from = api.coord([api.value(0), 0])[0], to = api.coord([api.value(1), 0])[0];
        if (to < area.x || from > end) return null;
        if (kind === "warm-up") return { type: "rect", shape: { x: Math.max(from, area.x), y: top, width: Math.max(Math.min(to, end) - Math.max(from, area.x), 1), height: bottom - top }, style: { fill: ink, opacity: 0.12 } };
        if (kind === "border") return { type: "line", shape: { x1: from, x2: from, y1: top, y2: bottom }, style: { stroke: ink, lineWidth: 1, lineDash: [4, 3] } };
        // Crosses that would overlap are drawn as one.
        if (from - (params.context.cross ?? -Infinity) < TOUCHING) return null;
        params.context.cross = from;
        return { type: "path", x: from - 6 * size, y: top - 13 * size, scaleX: size, scaleY: size, shape: { pathData: iconPath("failed") }, style: { fill: "none", stroke: bad, lineWidth: 1.5, strokeNoScale: true } };
      },
    };
  }

  // --- length of the buckets of means. The length depends only on the time range and the rate, so that every screen shows
  // the same figures. It is the shortest length with which every bucket contains an iteration even with jitter, and the
  // range has at most MAX_BUCKETS buckets, as many as a small screen can show.
  const BUCKETS = [1, 2, 5, 10, 30, 60], MAX_BUCKETS = 150;
  const bucket = (range, rate) => BUCKETS.find((size) => range / size <= MAX_BUCKETS && (!(rate > 0) || rate * size >= 1.5)) || 60;
  const ticks = ({ max, interval }) => Array.from({ length: Math.round(max / interval) + 1 }, (_, step) => NUMBERS.tick(step * interval));
  // Returns a round end of an axis above a value, in at most five steps of 1, 2 or 5 times a power of ten.
  function steps(value) {
    if (!(value > 0)) return { max: 1, interval: 0.5 };
    const rough = value / 5, power = 10 ** Math.floor(Math.log10(rough));
    const interval = [1, 2, 5, 10].find((factor) => factor * power >= rough * 0.999) * power;
    return { max: Math.ceil(value / interval - 1e-9) * interval, interval };
  }

  // --- drawing of visible charts, repeated when size or theme change
  let hovered = null;
  document.addEventListener("pointerover", (event) => { hovered = event.target.closest?.(".chart") || null; });
  const sight = new IntersectionObserver((entries) => {
    for (const entry of entries) {
      const drawing = entry.target.drawing;
      if (!drawing) continue;
      drawing.seen = entry.isIntersecting;
      if (drawing.seen && drawing.stale) redraw(drawing);
    }
  });
  // Draws a chart again. A chart outside the visible part of the page is drawn when it becomes visible, or at once if
  // `unseen`: a printed page contains all charts.
  function redraw(drawing, unseen = false) {
    drawing.stale = !unseen && (!drawing.seen || document.hidden);
    if (drawing.stale || !drawing.node.clientWidth) { drawing.stale = true; return; }
    const option = { animation: false, ...drawing.make(drawing.chart) };
    // By default ECharts narrows a plot when one of its labels comes near the edge, but not the plots above it. One time would then
    // have two positions.
    option.grid = option.grid.map((place) => ({ outerBoundsMode: "none", ...place }));
    // Options are merged if only figures changed, so that an open tooltip stays and is updated.
    const shape = option.series.map((series) => `${series.type} ${series.name}`).join() + option.grid.length;
    drawing.chart.setOption(option, { notMerge: shape !== drawing.shape });
    drawing.shape = shape;
  }
  function draw(node, make) {
    const drawing = { node, make, chart: echarts.init(node, null, { renderer: "canvas" }), seen: true, stale: false };
    // By default the renderer requests ten more animation frames after each drawing, which cost processor time.
    drawing.chart.getZr().setSleepAfterStill(1);
    node.drawing = drawing;
    drawn.add(drawing);
    redraw(drawing);
    sight.observe(node);
    new ResizeObserver(() => {
      if (!node.clientWidth) return;
      drawing.chart.resize();
      redraw(drawing);
    }).observe(node);
    return drawing;
  }
  // Releases the charts whose elements were removed from the page.
  function forget() {
    for (const drawing of drawn) if (!drawing.node.isConnected) { drawing.chart.dispose(); drawn.delete(drawing); }
  }
  document.addEventListener("peernet-theme", ({ detail }) => drawn.forEach((drawing) => redraw(drawing, detail === "print")));
  document.addEventListener("visibilitychange", () => { if (!document.hidden) drawn.forEach((drawing) => { if (drawing.stale) redraw(drawing); }); });

  return { PARTS, look, css, px, fill, lineColour, timeOfDay, text, sides, timeAxis, valueAxis, tooltip, tip, marks, runMarks, bucket, steps, ticks, draw, redraw, forget, isHovered: (node) => hovered === node };
})();
