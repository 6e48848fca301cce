// Chart of a run over time: median and 95th percentile per bucket, and the slowest iterations as links.
(() => {
  const node = document.getElementById("run-chart");
  if (!node) return;
  const data = JSON.parse(document.getElementById("data").textContent), size = data.bucket * 1000;
  // Selected time range as Unix times in ms; `null` for the whole run.
  let range = null;
  const fromHash = /^#t=(\d+)-(\d+)$/.exec(location.hash);
  if (fromHash) range = [Number(fromHash[1]), Number(fromHash[2])];

  const moments = [...data.slow.map((point) => point[0]), ...data.borders, ...data.failed, ...data.warm_up.flat()];
  const begin = Math.min(...data.points.map((point) => point[0]), ...moments);
  const end = Math.max(...data.points.map((point) => point[0] + size), ...moments);
  if (!Number.isFinite(begin)) return;

  const plotTop = () => PEER.px(2.25), plotBottom = () => node.clientHeight - PEER.px(3.5);

  // Returns the points of a line, each in the middle of its bucket. `index` is the position of the quantity in a point.
  // The line is interrupted where buckets are missing.
  function line(index) {
    const points = [];
    data.points.forEach((point, at) => {
      if (at > 0 && point[0] - data.points[at - 1][0] > size) points.push([point[0] - size / 2, null]);
      points.push([point[0] + size / 2, point[index]]);
    });
    return points;
  }

  function options() {
    const [from, to] = range || [begin, end];
    const top = plotTop(), height = plotBottom() - top;
    const highest = Math.max(...data.points.map((point) => Math.max(point[1] || 0, point[2] || 0)), ...data.slow.map((point) => point[1] || 0));
    const valueScale = PEER.steps(highest), short = to - from < 5000, timePrecision = short ? "ms" : to - from < 600000;
    const { left, right } = PEER.sides(PEER.ticks(valueScale), timePrecision);
    const gaps = data.gaps.map(([start, stop]) => ({ from: start, to: stop })).sort((one, other) => one.from - other.from);
    return {
      grid: [{ left, right, top, height }],
      dataZoom: [{
        type: "slider", left, right, bottom: PEER.px(0.125), height: PEER.px(1.25), startValue: from, endValue: to, filterMode: "none", brushSelect: false, showDetail: false,
        borderColor: PEER.css("--line"), backgroundColor: "transparent", fillerColor: PEER.css("--ink-3").replace("rgb(", "rgba(").replace(")", ", 0.12)"), moveHandleSize: 0,
        dataBackground: { lineStyle: { color: PEER.css("--ink-3"), width: 1, opacity: 1 }, areaStyle: { color: PEER.css("--well"), opacity: 1 } },
        selectedDataBackground: { lineStyle: { color: PEER.css("--ink-2"), width: 1, opacity: 1 }, areaStyle: { color: PEER.css("--line"), opacity: 1 } },
        handleStyle: { color: PEER.css("--surface"), borderColor: PEER.css("--line-strong") }, emphasis: { handleStyle: { borderColor: PEER.css("--ink") } },
      }],
      tooltip: PEER.tooltip((params) => {
        const point = params.find((one) => one.seriesType === "scatter");
        const at = params[0].axisValue;
        const bucket = data.points.find((one) => at >= one[0] && at < one[0] + size);
        const lines = [];
        if (bucket) lines.push({ name: "median", value: NUMBERS.milliseconds(bucket[1]) }, { name: "p95", value: NUMBERS.milliseconds(bucket[2]) });
        if (point) lines.push({ stage: point.data.stage, name: `iteration ${NUMBERS.count(point.data.number)}`, value: NUMBERS.milliseconds(point.value[1]), sum: lines.length > 0 });
        return lines.length ? PEER.tip(PEER.timeOfDay(bucket ? bucket[0] : at, true), `ms, ${data.bucket} s`, lines) : "";
      }),
      // An axis of a few seconds may have no round time between its ends.
      xAxis: PEER.timeAxis({ min: begin, max: end, timePrecision, ends: { showMinLabel: short, showMaxLabel: short } }),
      yAxis: PEER.valueAxis("ms", { ...valueScale, axisLabel: { ...PEER.text(), margin: PEER.px(0.375), formatter: NUMBERS.tick } }),
      series: [
        { type: "line", symbol: data.points.length === 1 ? "circle" : "none", data: line(1), lineStyle: { width: 2, color: PEER.css("--ink") }, itemStyle: { color: PEER.css("--ink") }, emphasis: { disabled: true }, z: 4 },
        { type: "line", symbol: "none", data: line(2), lineStyle: { width: 1, color: PEER.css("--ink-3") }, itemStyle: { color: PEER.css("--ink-3") }, emphasis: { disabled: true }, z: 3 },
        {
          type: "scatter", symbolSize: PEER.px(0.4375), z: 5, cursor: "pointer", emphasis: { disabled: true },
          data: data.slow.map(([at, total, stage, number]) => ({ value: [at, total], stage, number, itemStyle: { color: stage === "total" || stage === "other" ? PEER.css("--line-strong") : PEER.lineColour(stage) } })),
        },
        PEER.runMarks({ borders: data.borders, warmUp: data.warm_up, failed: data.failed }, [top, top + height]),
        PEER.marks([], gaps, [[top, top + height]], "not recorded"),
      ],
    };
  }

  const drawing = PEER.draw(node, options);
  drawing.chart.on("click", (event) => { if (event.data?.number) location.href = `/runs/${data.run}/iterations/${event.data.number}`; });

  // --- a slider, Ctrl and the wheel, or a drag across the plot select a time range; a double click shows the whole run again
  function select(next) {
    range = next;
    history.replaceState(null, "", next ? `#t=${Math.round(next[0])}-${Math.round(next[1])}` : location.pathname + location.search);
  }
  drawing.chart.on("datazoom", () => {
    const { startValue, endValue } = drawing.chart.getOption().dataZoom[0];
    select(startValue <= begin && endValue >= end ? null : [startValue, endValue]);
  });
  const zoom = (next) => { select(next); PEER.redraw(drawing); };
  const surface = drawing.chart.getZr();
  const inside = (event) => event.offsetY < plotBottom();
  // Position of the pointer when the button was pressed, and the rectangle that shows the dragged range.
  let pressedX = null, dragArea = null;
  surface.on("mousedown", (event) => { if (!event.target && inside(event)) pressedX = event.offsetX; });
  surface.on("mousemove", (event) => {
    if (pressedX == null || Math.abs(event.offsetX - pressedX) < 4) return;
    const shape = { x: Math.min(pressedX, event.offsetX), y: plotTop(), width: Math.abs(event.offsetX - pressedX), height: plotBottom() - plotTop() };
    if (dragArea) { dragArea.setShape(shape); return; }
    dragArea = new echarts.graphic.Rect({ silent: true, z: 9, style: { fill: PEER.css("--ink"), opacity: 0.09 }, shape });
    surface.add(dragArea);
  });
  const release = (event) => {
    if (dragArea) {
      surface.remove(dragArea);
      const time = (x) => drawing.chart.convertFromPixel({ xAxisIndex: 0 }, x);
      const [from, to] = event ? [time(Math.min(pressedX, event.offsetX)), time(Math.max(pressedX, event.offsetX))] : [0, 0];
      // No bucket is shorter than a second, so a shorter range would show nothing more.
      if (to - from >= 1000) zoom([Math.max(begin, from), Math.min(end, to)]);
    }
    pressedX = dragArea = null;
  };
  surface.on("mouseup", release);
  surface.on("globalout", () => release(null));
  surface.on("dblclick", () => zoom(null));
})();
