// Sliders of the gallery: the left part of a picture shows the one that it is compared with.
document.addEventListener("input", (event) => {
  const frame = event.target.closest(".before-after");
  if (frame) frame.style.setProperty("--share", `${event.target.value}%`);
});
