// A browser starts no Worker for a page that it opened from a file, so the search would not work there. This class has
// the part of the Worker interface that the search uses, and runs the worker's script in a hidden frame instead.
"use strict";

class FrameWorker extends EventTarget {
  constructor(url) {
    super();
    this.onmessage = null;
    this.waiting = [];
    this.frame = document.createElement("iframe");
    this.frame.hidden = true;
    const attach = () => document.body.appendChild(this.frame) && this.start(new URL(url, document.baseURI));
    if (document.body) attach();
    else addEventListener("DOMContentLoaded", attach);
  }

  start(url) {
    const inside = this.frame.contentWindow;
    const page = inside.document;
    inside.postMessage = (data) => setTimeout(() => this.receive(data)); // later, as from a Worker
    inside.importScripts = (...addresses) =>
      Promise.all(addresses.map((address) => this.load(page, new URL(address, document.baseURI))));
    this.load(page, url).then(() => {
      const messages = this.waiting;
      this.waiting = null;
      messages.forEach((data) => this.postMessage(data));
    });
  }

  load(page, url) {
    return new Promise((done, failed) => {
      const script = page.createElement("script");
      script.src = url.href;
      script.onload = done;
      script.onerror = failed;
      page.body.appendChild(script);
    });
  }

  receive(data) {
    const event = new MessageEvent("message", { data });
    if (this.onmessage) this.onmessage(event);
    this.dispatchEvent(event);
  }

  postMessage(data) {
    if (this.waiting) this.waiting.push(data);
    else {
      const inside = this.frame.contentWindow;
      setTimeout(() => inside.dispatchEvent(new inside.MessageEvent("message", { data })));
    }
  }

  terminate() {
    this.frame.remove();
  }
}

if (location.protocol === "file:") window.Worker = FrameWorker;
