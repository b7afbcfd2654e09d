"use strict";
document.querySelectorAll(".slider").forEach((part) => {
  const pair = part.querySelector(".pair"), slider = part.querySelector("input"), name = part.querySelector(".name.right");
  const tabs = [...part.querySelectorAll("[role=tab]")], panels = [...part.querySelectorAll("[role=tabpanel]")];
  const captions = [...part.querySelectorAll("[data-caption]")];
  const edge = () => pair.style.setProperty("--at", `${slider.value}%`);
  const at = (event) => {
    const box = pair.getBoundingClientRect();
    slider.value = 100 * (event.clientX - box.left) / box.width;
    edge();
  };
  slider.addEventListener("input", edge);
  pair.addEventListener("pointerdown", (event) => { pair.setPointerCapture(event.pointerId); at(event); });
  pair.addEventListener("pointermove", (event) => { if (event.buttons) at(event); });
  const choose = (chosen) => {
    tabs.forEach((tab, number) => {
      tab.setAttribute("aria-selected", number === chosen);
      tab.tabIndex = number === chosen ? 0 : -1;
      panels[number].hidden = captions[number].hidden = number !== chosen;
    });
    name.textContent = tabs[chosen].textContent;
  };
  tabs.forEach((tab, number) => {
    tab.addEventListener("click", () => choose(number));
    tab.addEventListener("keydown", (event) => {
      const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
      if (!step) return;
      event.preventDefault();
      const next = (number + step + tabs.length) % tabs.length;
      choose(next);
      tabs[next].focus();
    });
  });
  edge();
});
