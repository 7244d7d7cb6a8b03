/* The page's own script: colour scheme, figures drawn when they come into view, the slider, printing. */
(function () {
  "use strict";
  const root = document.documentElement;
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const DARK_COLORS = JSON.parse(document.getElementById("dark-colors").textContent);
  const NARROW_PX = 600;
  /* Width of a card's drawing on paper [px]: A4 between its margins, at the zoom of the style sheet. */
  const PAPER_PX = { wide: 1034, half: 493 };
  const CONFIG = { displaylogo: false, displayModeBar: "hover", modeBarButtonsToRemove: ["select2d", "lasso2d"],
    /* Not two pixels for one, as the library does: without a graphics processor that is four times the work. */
    plotGlPixelRatio: Math.min(2, Math.max(1, devicePixelRatio)) };

  /* Compressed texts. */
  function bytesOf(base64) {
    const text = atob(base64), bytes = new Uint8Array(text.length);
    for (let k = 0; k < text.length; k++) bytes[k] = text.charCodeAt(k);
    return bytes;
  }
  function inflated(node) {
    const stream = new Blob([bytesOf(node.textContent.trim())]).stream();
    return new Response(stream.pipeThrough(new DecompressionStream("deflate"))).text();
  }
  let library = null;
  function loadLibrary() {
    if (!library) {
      const start = performance.now();
      library = inflated(document.getElementById("plotly")).then(function (text) {
        const script = document.createElement("script"), limit = Error.stackTraceLimit;
        script.textContent = text;
        /* The library makes errors as it starts; where in 5 MB they were made nobody asks, and it takes long to find. */
        Error.stackTraceLimit = 0;
        document.head.append(script);
        Error.stackTraceLimit = limit;
        performance.measure("plotly", { start });
      });
    }
    return library;
  }

  /* Figures. */
  const figures = Array.from(document.querySelectorAll("script.figure"), function (node) {
    const drawing = document.getElementById(node.dataset.target);
    return { node, drawing, plot: drawing.parentElement, text: null, clock: "", width: 0, drawn: false, stale: false, near: false, inView: false, moments: [] };
  });
  const isPrinting = { now: false };
  function isDark() {
    if (isPrinting.now) return false;
    return root.dataset.scheme ? root.dataset.scheme === "dark" : dark.matches;
  }
  function content(figure) {
    let text = figure.text;
    if (isDark()) for (const light in DARK_COLORS) text = text.replaceAll('"' + light, '"' + DARK_COLORS[light]);
    const found = JSON.parse(text), layout = found.layout;
    layout.uirevision = "kept";
    figure.width = figure.plot.clientWidth || NARROW_PX;
    layout.autosize = false;
    layout.width = figure.width;
    if (!isPrinting.now && figure.width < NARROW_PX) for (const key in found.narrow) {
      const part = found.narrow[key];
      layout[key] = part && typeof part === "object" && !Array.isArray(part) ? Object.assign({}, layout[key], part) : part;
    }
    if (isPrinting.now) layout.width = figure.plot.closest(".wide") ? PAPER_PX.wide : PAPER_PX.half;
    figure.plot.style.height = layout.height + "px";
    figure.clock = found.clock;
    return found;
  }
  async function draw(figure) {
    if (figure.text === null) figure.text = await inflated(figure.node);
    await loadLibrary();
    if (figure.drawn) return;
    const found = content(figure), start = performance.now();
    figure.drawn = true;
    figure.drawing.classList.remove("waiting");
    figure.drawing.textContent = "";
    await Plotly.newPlot(figure.drawing, found.data, found.layout, CONFIG);
    figure.drawing.on("plotly_afterplot", function () { placeMoments(figure); });
    placeAll(figure);
    performance.measure(figure.drawing.id, { start });
  }
  function redraw(figure) {
    if (!figure.drawn) return;
    figure.stale = false;
    const found = content(figure);
    Plotly.react(figure.drawing, found.data, found.layout, CONFIG);
    placeAll(figure);
  }
  /* Drawn in the other scheme, or for another width. */
  function isOld(figure) {
    const width = figure.plot.clientWidth;
    return figure.drawn && (figure.stale || (width > 0 && width !== figure.width));
  }
  let drawing = null;
  function wanted() {
    return figures.find(function (each) { return each.inView && !each.drawn; }) || figures.find(function (each) { return each.near && !each.drawn; });
  }
  async function drawWanted() {
    for (let next = wanted(); next; next = wanted()) {
      await draw(next);
      noteProgress();
      /* The browser answers the reader between two figures. */
      await new Promise(function (resolve) { setTimeout(resolve, 0); });
    }
  }
  function drawNear() {
    if (!drawing) drawing = drawWanted().finally(function () { drawing = null; noteProgress(); if (wanted()) drawNear(); });
    return drawing;
  }
  /* For measurements: milliseconds until all that is in view was drawn, and whether everything is. */
  function noteProgress() {
    const data = document.body.dataset;
    if (!data.shown && !figures.some(function (each) { return each.inView && !each.drawn; })) data.shown = Math.round(performance.now());
    if (figures.every(function (each) { return each.drawn; })) data.drawn = "yes";
  }
  async function drawAll() {
    for (const each of figures) each.near = true;
    while (wanted()) await drawNear();
    for (const each of figures) if (isOld(each)) redraw(each);
  }
  const byNode = new Map(figures.map(function (each) { return [each.plot, each]; }));
  const near = new IntersectionObserver(function (entries) {
    for (const entry of entries) if (entry.isIntersecting) byNode.get(entry.target).near = true;
    drawNear();
  }, { rootMargin: "500px 0px" });
  const seen = new IntersectionObserver(function (entries) {
    for (const entry of entries) {
      const figure = byNode.get(entry.target);
      figure.inView = entry.isIntersecting;
      if (figure.inView && isOld(figure)) redraw(figure);
      else if (figure.inView && figure.drawn) placeAll(figure);
    }
    noteProgress();
    drawNear();
  });
  for (const each of figures) { seen.observe(each.plot); near.observe(each.plot); }

  /* Colour scheme: the system's, or what the switch was set to. */
  /* Now where the reader looks, elsewhere when it comes into view. */
  function refresh(figure) {
    if (figure.inView) redraw(figure);
    else figure.stale = figure.drawn;
  }
  function redrawAll() { figures.forEach(refresh); }
  dark.addEventListener("change", function () { if (!root.dataset.scheme) redrawAll(); });
  for (const button of document.querySelectorAll(".switch")) button.addEventListener("click", function () {
    root.dataset.scheme = isDark() ? "light" : "dark";
    try { localStorage.setItem("polhode-scheme", root.dataset.scheme); } catch (error) { /* not kept, where a page may store nothing */ }
    redrawAll();
  });
  let resized = 0;
  window.addEventListener("resize", function () {
    clearTimeout(resized);
    resized = setTimeout(function () {
      for (const each of figures) if (isOld(each)) refresh(each);
    }, 150);
  });

  /* The slider: one moment in the picture, the body, the polhode and the plots. */
  const clock = document.querySelector(".clock"), lineNode = document.getElementById("timeline");
  let line = null, pictures = [], stop = 0, playing = 0;
  if (clock && lineNode) inflated(lineNode).then(function (text) {
    line = JSON.parse(text);
    const filmNode = document.getElementById("film-frames");
    pictures = filmNode ? JSON.parse(filmNode.textContent) : [];
    const slider = clock.querySelector("input");
    slider.max = line.time.length - 1;
    slider.value = 0;
    slider.addEventListener("input", function () { pause(); show(Number(slider.value)); });
    clock.querySelector("button").addEventListener("click", function () { if (playing) pause(); else play(); });
    clock.hidden = false;
    show(0);
  });
  function show(index) {
    stop = index;
    clock.querySelector("input").value = index;
    clock.querySelector("output").innerHTML = '<span class="long">frame ' + (line.frame[index] + 1) + " of " + line.frames + ", </span>" + line.time[index].toFixed(1) + " s";
    const film = document.getElementById("film");
    if (film && line.picture && pictures.length) film.src = pictures[line.picture[index]];
    for (const each of figures) if (each.drawn && each.inView) placeAll(each);
  }
  function placeAll(figure) {
    if (!line) return;
    placeMoments(figure);
    if (figure.drawing.id === "plot-polhode") movePoint(figure);
    if (figure.drawing.id === "plot-mesh" || figure.drawing.id === "plot-sparse-map") turnBody(figure);
  }
  function placeMoments(figure) {
    const full = figure.drawing._fullLayout;
    if (!line || !figure.clock || !full || !full._plots) return;
    const value = figure.clock === "time" ? line.time[stop] : line.frame[stop] + 1;
    const panels = Object.values(full._plots).filter(function (panel) { return panel.xaxis._id === "x" || panel.xaxis.matches === "x"; });
    while (figure.moments.length < panels.length) {
      const mark = document.createElement("div");
      mark.className = "moment";
      figure.plot.append(mark);
      figure.moments.push(mark);
    }
    panels.forEach(function (panel, k) {
      const x = panel.xaxis, y = panel.yaxis, at = x.d2p(value), style = figure.moments[k].style;
      style.display = at >= 0 && at <= x._length ? "" : "none";
      style.left = x._offset + at - 1 + "px";
      style.top = y._offset + "px";
      style.height = y._length + "px";
    });
  }
  function movePoint(figure) {
    const data = figure.drawing.data, index = data.length - 1, rate = line.rate[stop];
    Plotly.restyle(figure.drawing, { x: [[rate[0]]], y: [[rate[1]]], z: [[rate[2]]] }, [index]);
  }
  function turnBody(figure) {
    if (!line.eye) return;
    const eye = line.eye[stop], up = line.up[stop], away = 1.6, vector = function (v, scale) { return { x: scale * v[0], y: scale * v[1], z: scale * v[2] }; };
    Plotly.relayout(figure.drawing, { "scene.camera": { eye: vector(eye, away), up: vector(up, 1), center: { x: 0, y: 0, z: 0 } } });
  }
  function play() {
    clock.querySelector("button").textContent = "Pause";
    const pause_ms = Math.max(60, 12000 / line.time.length);
    playing = setInterval(function () { show((stop + Math.max(1, Math.round(line.time.length / 200))) % line.time.length); }, pause_ms);
  }
  function pause() {
    clearInterval(playing);
    playing = 0;
    clock.querySelector("button").textContent = "Play";
  }

  /* Contents: where the reader is, and sections that open when they are asked for. */
  const sections = Array.from(document.querySelectorAll("main [id].section, main h2[id]"));
  function mark() {
    let here = "";
    for (const each of sections) if (each.getBoundingClientRect().top < 0.4 * innerHeight) here = each.id;
    for (const link of document.querySelectorAll(".side a, .menu a")) link.classList.toggle("here", link.hash === "#" + here);
  }
  let marking = false;
  addEventListener("scroll", function () {
    if (marking) return;
    marking = true;
    requestAnimationFrame(function () { marking = false; mark(); });
  }, { passive: true });
  mark();
  for (const link of document.querySelectorAll(".side a, .menu a")) link.addEventListener("click", function () {
    const target = document.getElementById(link.hash.slice(1));
    if (target && target.tagName === "DETAILS") target.open = true;
    const menu = link.closest(".menu");
    if (menu) menu.open = false;
  });

  /* Print: light, everything open and drawn, drawings as wide as the paper. */
  let folded = [];
  addEventListener("beforeprint", function () {
    folded = Array.from(document.querySelectorAll("details:not([open]):not(.menu)"));
    for (const each of folded) each.open = true;
    isPrinting.now = true;
    figures.forEach(redraw);
  });
  addEventListener("afterprint", function () {
    isPrinting.now = false;
    for (const each of folded) each.open = false;
    redrawAll();
  });
  async function print() { await drawAll(); window.print(); }
  for (const button of document.querySelectorAll(".print")) button.addEventListener("click", print);
  addEventListener("keydown", function (event) {
    if ((event.ctrlKey || event.metaKey) && event.key === "p" && document.body.dataset.drawn !== "yes") { event.preventDefault(); print(); }
  });

  window.polhodeReport = { drawAll: drawAll, show: function (index) { show(index); }, stops: function () { return line ? line.time.length : 0; } };
})();
