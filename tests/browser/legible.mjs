// Legibility of figures: complete, not overlapping, and at the right position of the time axis.
import assert from "node:assert/strict";
import { describe, test } from "node:test";
import { openWithData, waitForCharts, open } from "./browser.mjs";
import { base, browser, pages } from "./dashboard.mjs";

describe("charts", () => {
  // Returns for each chart the left edges and widths of its plots, as configured (`wanted`) and as drawn (`found`), and
  // the labels that exceed its canvas (`cut`).
  const plots = (page) => page.evaluate(() => Array.from(document.querySelectorAll(".chart"), (node) => {
    const chart = globalThis.echarts.getInstanceByDom(node), model = chart.getModel();
    const cut = chart.getZr().storage.getDisplayList(true).filter((one) => one.type === "tspan" && one.style.text).flatMap((one) => {
      const box = one.getBoundingRect().clone();
      if (one.transform) box.applyTransform(one.transform);
      return box.x < 0 || box.x + box.width > chart.getWidth() ? [one.style.text] : [];
    });
    const option = chart.getOption().grid, rects = model.queryComponents({ mainType: "grid" }).map((grid) => grid.coordinateSystem.getRect());
    const wanted = option.map(({ left, right }) => [left, chart.getWidth() - left - right]);
    return { wanted, found: rects.map(({ x, width }) => [x, width]), cut };
  }));

  // Shifts the data so that the label of a minute touches the right edge: the data then ends 8 s
  // after this minute.
  function shiftLabelToEdge(data) {
    const end = Math.max(...data.charts.map((chart) => chart.from + chart.n.length)), shift = 240 - (end % 120) + 8;
    for (const chart of data.charts) {
      chart.from += shift;
      for (const list of [chart.cpu, chart.gpu]) list.forEach((point) => { point[0] += shift; });
    }
  }

  for (const width of [400, 1300]) {
    test(`plots of a chart share a time axis: ${width} px`, async () => {
      for (const path of ["/", pages.pipeline]) {
        const { page, errors, close } = await openWithData(browser, base, path, shiftLabelToEdge, { width });
        const charts = await plots(page);
        assert.ok(charts.length > 0 && charts.every(({ found }) => found.length > 1), path);
        for (const { wanted, found, cut } of charts) {
          assert.deepEqual(found, found.map(() => found[0]), `${path}: plots beside each other`);
          assert.deepEqual(found, wanted, path);
          assert.deepEqual(cut, [], `${path}: labels that are cut off`);
        }
        // The live stream is blocked, which the browser reports.
        assert.deepEqual(errors.filter((one) => !one.includes("live") && !one.includes("ERR_FAILED")), [], path);
        await close();
      }
    });
  }

  test("long axis labels are not cut off", async () => {
    const change = (data) => {
      const [chart] = data.charts;
      Object.assign(chart, { remote: true, obstacles: [null, null], transfers: { up: chart.n.map(() => [23456.7, 1]), down: chart.n.map(() => [0.000123, 1]) } });
      chart.p95.points = chart.p95.points.map(([at, value]) => [at, value * 1e5]);
    };
    const { page, close } = await openWithData(browser, base, "/", change, { width: 400 });
    for (const { wanted, found, cut } of await plots(page)) {
      assert.deepEqual(found, wanted);
      assert.deepEqual(cut, []);
    }
    await close();
  });

  test("plot, slider and gaps of a run are aligned", async () => {
    for (const width of [400, 1300]) {
      const { page, close } = await open(browser, base, pages.run, { width });
      await waitForCharts(page);
      const [{ wanted, found, cut }] = await plots(page);
      assert.deepEqual(found, wanted, `${width} px`);
      assert.deepEqual(cut, [], `${width} px`);
      await close();
    }
  });
});

describe("small screens", () => {
  // Returns the illegible figures of a page: cut off, outside of the page, overlapping, or in a bar
  // of stages wider than their stage or crossed by a whisker.
  const unreadable = (page) => page.evaluate(() => {
    const found = [], texts = [];
    const isCutting = (style) => [style.overflowX, style.overflowY].some((how) => how === "hidden" || how === "clip");
    const walker = document.createTreeWalker(document.querySelector("main"), NodeFilter.SHOW_TEXT);
    for (let node = walker.nextNode(); node; node = walker.nextNode()) {
      if (!/\d/.test(node.data) || !node.parentElement.checkVisibility({ visibilityProperty: true }) || node.parentElement.closest(".sr, title, defs")) continue;
      const range = document.createRange();
      range.selectNodeContents(node);
      for (const box of range.getClientRects()) {
        if (!box.width || !box.height) continue;
        let isSeen = true;
        for (let one = node.parentElement; one.id !== "main"; one = one.parentElement) {
          const style = getComputedStyle(one), edge = one.getBoundingClientRect();
          const isOut = box.left < edge.left - 1 || box.right > edge.right + 1 || box.top < edge.top - 3 || box.bottom > edge.bottom + 3;
          // The reader can scroll to a text that is outside of a scrollable element.
          if (isOut && ["auto", "scroll"].includes(style.overflowX)) isSeen = false;
          else if (isOut && isCutting(style) && style.display !== "inline") found.push(`${node.data.trim()}: cut off`);
        }
        if (isSeen && (box.left < 0 || box.right > innerWidth)) found.push(`${node.data.trim()}: outside the page`);
        if (isSeen) texts.push({ words: node.data.trim(), node, box });
      }
    }
    texts.forEach((one, at) => {
      for (const other of texts.slice(at + 1)) {
        if (other.node === one.node) continue;
        const wide = Math.min(one.box.right, other.box.right) - Math.max(one.box.left, other.box.left);
        const high = Math.min(one.box.bottom, other.box.bottom) - Math.max(one.box.top, other.box.top);
        if (wide > 1 && high > Math.min(one.box.height, other.box.height) / 3) found.push(`${one.words}: printed over ${other.words}`);
      }
    });
    for (const text of document.querySelectorAll("svg.stages text:not(.beyond)")) {
      const inner = text.getBoundingClientRect(), middle = (inner.left + inner.right) / 2;
      const stages = Array.from(text.parentElement.querySelectorAll("rect"), (rect) => rect.getBoundingClientRect());
      const outer = stages.find(({ left, right }) => left <= middle && middle <= right);
      if (inner.width > 0 && !(inner.left >= outer?.left && inner.right <= outer?.right)) found.push(`${text.textContent}: wider than its stage`);
      // The whisker of the total is at half the height of a bar, as the labels are.
      for (const line of text.parentElement.querySelectorAll(".whisk2[y1='50%']")) {
        const over = line.getBoundingClientRect();
        if (inner.width > 0 && Math.min(inner.right, over.right) > Math.max(inner.left, over.left)) found.push(`${text.textContent}: crossed out`);
      }
    }
    return [...new Set(found)];
  });

  for (const width of [320, 400]) {
    test(`no figure is cut off or overlaps: ${width} px`, async () => {
      const wrong = [];
      for (const [name, path] of Object.entries(pages)) {
        const { page, close } = await open(browser, base, path, { width, height: 800 });
        await waitForCharts(page);
        for (const one of await unreadable(page)) wrong.push(`${name}: ${one}`);
        await close();
      }
      assert.deepEqual(wrong, []);
    });
  }

  test("figures with many digits fit their cells", async () => {
    const { page, close } = await open(browser, base, pages.compare, { width: 400, height: 800 });
    const count = await page.locator(".compare td.num:has(.pm)").evaluateAll((cells) => {
      for (const cell of cells) {
        cell.firstChild.data = "0.000139 ";
        cell.querySelector(".pm").textContent = "± 0.000080";
      }
      return cells.length;
    });
    assert.ok(count > 3, "there are cells with a deviation");
    assert.deepEqual(await unreadable(page), []);
    await close();
  });
});
